//! The service as its users see it: each test has a server on its own port with its own data
//! directory, and sends HTTP from outside.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod accept;
mod adversarial;
mod answers;
mod binary;
mod broken;
mod charges;
mod client;
mod connections;
mod downloads;
mod existing;
mod idempotency;
mod marking;
mod nothing;
mod origins;
mod process;
mod protocol;
mod quality;
mod recognition;
mod records;
mod refusals;
mod relief;
mod server;
mod storage;
#[path = "../support/mod.rs"]
mod support;
mod uploads;
mod work;
