//! `quadmark health`: asks a running service whether it is ready. For container health checks.

use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream};
use std::process::ExitCode;
use std::time::Duration;

use quadmark::config::{Config, ConfigArgs};

use super::{Failure, Outcome};

const TIMEOUT: Duration = Duration::from_secs(5);
/// Most bytes that are read: only the status line is needed.
const MOST: u64 = 1024;

/// The source of the settings; only the address is used.
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    config: ConfigArgs,
}

/// Prints `ok` or fails.
pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut args = arguments.config.clone();
    // A query is harmless wherever the service listens.
    args.settings.insecure_listen = Some(true);
    let address = reachable(Config::load(args)?.listen);
    let status =
        ask(address).map_err(|error| Failure(format!("{address} does not answer: {error}")))?;
    if status.starts_with("HTTP/1.1 200 ") {
        println!("ok");
        return Ok(ExitCode::SUCCESS);
    }
    let line = status.lines().next().unwrap_or_default();
    Err(Failure(format!("{address} is not ready: {line}")))
}

/// The address to ask: loopback for a service that listens on all addresses.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(match address {
            SocketAddr::V4(_) => IpAddr::V4(Ipv4Addr::LOCALHOST),
            SocketAddr::V6(_) => IpAddr::V6(Ipv6Addr::LOCALHOST),
        });
    }
    address
}

fn ask(address: SocketAddr) -> io::Result<String> {
    let mut stream = TcpStream::connect_timeout(&address, TIMEOUT)?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.set_write_timeout(Some(TIMEOUT))?;
    write!(stream, "GET /readyz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut answer = Vec::new();
    stream.take(MOST).read_to_end(&mut answer)?;
    Ok(String::from_utf8_lossy(&answer).into_owned())
}
