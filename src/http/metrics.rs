//! Counters of requests, and the page that Prometheus reads.
//!
//! Labels are routes, never paths: a caller must not be able to create time series.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::service::Service;

/// Requests by route, method and status.
#[derive(Debug)]
pub(crate) struct Metrics {
    start: Instant,
    requests: Mutex<BTreeMap<(String, &'static str, u16), Requests>>,
}

#[derive(Debug, Default, Clone, Copy)]
struct Requests {
    count: u64,
    time: Duration,
}

impl Default for Metrics {
    fn default() -> Self {
        Self { start: Instant::now(), requests: Mutex::default() }
    }
}

impl Metrics {
    pub(super) fn count(&self, route: &str, method: &str, status: u16, time: Duration) {
        // A method is free text in HTTP, so an unknown one is counted as `other`.
        let method = ["GET", "POST", "DELETE", "HEAD", "PUT", "PATCH", "OPTIONS"]
            .into_iter()
            .find(|known| *known == method)
            .unwrap_or("other");
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = requests.entry((route.to_owned(), method, status)).or_default();
        entry.count += 1;
        entry.time += time;
    }

    pub(super) fn page(&self, service: &Service) -> String {
        let mut page = String::with_capacity(4096);
        let pool = service.pool();
        let gauges = [
            ("quadmark_uptime_seconds", "Seconds since the start", self.start.elapsed().as_secs()),
            ("quadmark_marks", "Marks that are searched", service.marks() as u64),
            (
                "quadmark_marks_unreadable",
                "Marks that are not searched because their master keys are missing",
                service.unreadable_marks() as u64,
            ),
            ("quadmark_jobs_running", "Jobs that run now", pool.running() as u64),
            ("quadmark_job_slots_free", "Jobs that would be taken now", pool.free_slots() as u64),
        ];
        for (name, help, value) in gauges {
            // Writing to a String cannot fail.
            let _ = writeln!(page, "# HELP {name} {help}\n# TYPE {name} gauge\n{name} {value}");
        }
        let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let _ = writeln!(
            page,
            "# HELP quadmark_requests_total Requests answered\n\
             # TYPE quadmark_requests_total counter"
        );
        for ((route, method, status), seen) in &requests {
            let labels = format!("route=\"{route}\",method=\"{method}\",status=\"{status}\"");
            let _ = writeln!(page, "quadmark_requests_total{{{labels}}} {}", seen.count);
        }
        let _ = writeln!(
            page,
            "# HELP quadmark_request_seconds_total Time spent answering\n\
             # TYPE quadmark_request_seconds_total counter"
        );
        for ((route, method, status), seen) in &requests {
            let labels = format!("route=\"{route}\",method=\"{method}\",status=\"{status}\"");
            let seconds = seen.time.as_secs_f64();
            let _ = writeln!(page, "quadmark_request_seconds_total{{{labels}}} {seconds}");
        }
        page
    }
}
