//! Which clients may use a service without a login: programs, and the service's own pages.
//!
//! A browser sends requests to loopback addresses on behalf of any page that is open in it. Three
//! headers distinguish such requests from those of the service's own pages and of programs; curl
//! and HTTP libraries send neither of the last two.
//!
//! - `Host` must be a name of this service. A page that makes its own name resolve to this machine
//!   (DNS rebinding) is same-origin for the browser, but the request still carries the page's name.
//! - `Sec-Fetch-Site`, which no script can set, must not say that another site sent the request. A
//!   link to the documentation is harmless and allowed.
//! - `Origin`, for browsers that send no newer header, must be this service.

use std::net::{IpAddr, SocketAddr};

use axum::extract::Request;
use axum::http::{HeaderMap, Method, Version, header};

use super::code::Code;
use super::error::ApiError;

/// Paths that another site may link to.
const DOCUMENTATION: [&str; 2] = ["/docs", "/openapi.yaml"];

/// The names by which a service may be addressed.
#[derive(Debug)]
pub(super) struct Origins {
    /// The address it listens on.
    own: IpAddr,
    /// Whether any name is allowed. Origins are checked all the same.
    any: bool,
    names: Vec<Authority>,
}

/// A host and an optional port.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Authority {
    /// In lower case, without brackets and final dot.
    host: String,
    port: Option<u16>,
}

impl Authority {
    fn read(text: &str) -> Option<Self> {
        let port_of = |text: &str| text.strip_prefix(':').map(str::parse).transpose().ok();
        let (host, port) = if let Some(rest) = text.strip_prefix('[') {
            let (host, rest) = rest.split_once(']')?;
            (host, if rest.is_empty() { None } else { Some(port_of(rest)??) })
        } else {
            let colon = text.find(':').unwrap_or(text.len());
            let (host, rest) = text.split_at_checked(colon)?;
            (host, if rest.is_empty() { None } else { Some(port_of(rest)??) })
        };
        let host = host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase();
        (!host.is_empty()).then_some(Self { host, port })
    }

    fn ip(&self) -> Option<IpAddr> {
        self.host.parse().ok().map(|ip: IpAddr| ip.to_canonical())
    }
}

impl Origins {
    /// The names of a service that listens on `address` and is also known under `names` (`name` or
    /// `name:port`; `*` for any name).
    pub(super) fn new(address: SocketAddr, names: &[String]) -> Self {
        Self {
            own: address.ip().to_canonical(),
            any: names.iter().any(|name| name == "*"),
            names: names.iter().filter_map(|name| Authority::read(name)).collect(),
        }
    }

    /// Refuses requests that a page of another origin sent.
    pub(super) fn check(&self, request: &Request) -> Result<(), ApiError> {
        let headers = request.headers();
        let host = host_of(request)?;
        if let Some(host) = &host
            && !self.is_named(host)
        {
            let name: String = host.host.chars().take(100).collect();
            let text = format!(
                "the service is not known as {name:?}; ask for it by its address, or let its \
                 operator add the name: --allowed-hosts {name}"
            );
            return Err(ApiError::new(Code::HostNotAllowed, text));
        }
        let site = headers.get("sec-fetch-site").map(|value| value.to_str().unwrap_or_default());
        let own_site = matches!(site, None | Some("same-origin" | "none"));
        if !own_site && !is_link_to_documentation(request) {
            return Err(cross_origin());
        }
        for origin in headers.get_all(header::ORIGIN) {
            let origin = origin.to_str().unwrap_or_default();
            if !self.is_own_origin(origin, host.as_ref()) {
                return Err(cross_origin());
            }
        }
        Ok(())
    }

    fn is_named(&self, host: &Authority) -> bool {
        if self.any || host.host == "localhost" || host.host.ends_with(".localhost") {
            return true;
        }
        if let Some(ip) = host.ip() {
            // DNS rebinding uses a name, not an address. A service that listens for other machines
            // may be addressed by any of its addresses.
            if ip.is_loopback() || ip == self.own || !self.own.is_loopback() {
                return true;
            }
        }
        let same = |name: &Authority| {
            name.host == host.host && name.port.is_none_or(|port| Some(port) == host.port)
        };
        self.names.iter().any(same)
    }

    /// Whether an origin is the host of the request, or one of the names of the settings: behind a
    /// proxy, the host may differ from the one that the browser asked for.
    fn is_own_origin(&self, origin: &str, host: Option<&Authority>) -> bool {
        let (default, authority) = match origin.split_once("://") {
            Some(("http", authority)) => (80, authority),
            Some(("https", authority)) => (443, authority),
            _ => return false,
        };
        let Some(origin) = Authority::read(authority) else { return false };
        let port = |authority: &Authority| authority.port.unwrap_or(default);
        let same = |name: &Authority| name.host == origin.host && port(name) == port(&origin);
        host.is_some_and(same) || self.names.iter().any(same)
    }
}

/// The host that the request names; `None` for HTTP/1.0, which no browser speaks and where the
/// header may be missing.
fn host_of(request: &Request) -> Result<Option<Authority>, ApiError> {
    let malformed = || {
        ApiError::new(Code::MalformedRequest, "send one Host header: the address of the service")
    };
    let mut lines = request.headers().get_all(header::HOST).iter();
    let (line, more) = (lines.next(), lines.next());
    if more.is_some() {
        return Err(malformed());
    }
    // An absolute target (RFC 9112, section 3.2.2) overrides the header.
    let named = match (request.uri().authority(), line) {
        (Some(authority), _) => Some(authority.as_str()),
        (None, Some(line)) => Some(line.to_str().map_err(|_| malformed())?),
        (None, None) => None,
    };
    match named {
        Some(text) => Ok(Some(Authority::read(text).ok_or_else(malformed)?)),
        None if request.version() == Version::HTTP_10 => Ok(None),
        None => Err(malformed()),
    }
}

/// Whether the request follows a link on another site, in a window of its own.
fn is_link_to_documentation(request: &Request) -> bool {
    let says = |headers: &HeaderMap, name: &str, expected: &str| {
        headers.get(name).is_some_and(|value| value == expected)
    };
    matches!(*request.method(), Method::GET | Method::HEAD)
        && DOCUMENTATION.contains(&request.uri().path())
        && says(request.headers(), "sec-fetch-mode", "navigate")
        && says(request.headers(), "sec-fetch-dest", "document")
}

fn cross_origin() -> ApiError {
    ApiError::new(
        Code::CrossOrigin,
        "a page of another origin sent this, and the service answers its own pages and programs \
         only; send it from a program, or, where a proxy shows the service under another name, \
         let its operator add that name with --allowed-hosts",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;

    const SITE: &str = "sec-fetch-site";

    fn origins(listen: &str, names: &[&str]) -> Origins {
        let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
        Origins::new(listen.parse().unwrap(), &names)
    }

    fn code(origins: &Origins, method: &str, uri: &str, headers: &[(&str, &str)]) -> &'static str {
        let mut request = Request::builder().method(method).uri(uri);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let refusal = origins.check(&request.body(Body::empty()).unwrap());
        refusal.map_or_else(|refusal| refusal.code().name(), |()| "")
    }

    fn of_host(origins: &Origins, host: &str) -> bool {
        code(origins, "GET", "/docs", &[("host", host)]).is_empty()
    }

    #[test]
    fn hosts_of_a_loopback_service() {
        let own = origins("127.0.0.1:8080", &["marks.test", "alias:8443"]);
        for host in [
            "127.0.0.1:8080",
            "127.0.0.1",
            "127.9.9.9:80",
            "localhost:8080",
            "LOCALHOST.",
            "a.localhost",
            "[::1]:8080",
            "[::ffff:127.0.0.1]",
            "marks.test",
            "Marks.Test:99",
            "alias:8443",
        ] {
            assert!(of_host(&own, host), "{host}");
        }
        for host in [
            "evil.test:8080",
            "localhost.evil.test",
            "127.0.0.1.evil.test",
            "0.0.0.0:8080",
            "192.168.1.7:8080",
            "alias",
            "alias:8080",
            "[fe80::1]",
            "",
            "[::1",
            "localhost:port",
            "localhost:99999",
            "a:b:c",
        ] {
            assert!(!of_host(&own, host), "{host}");
        }
        assert_eq!(code(&own, "GET", "/docs", &[("host", "evil.test")]), "host_not_allowed");
        assert_eq!(
            code(&own, "GET", "http://evil.test/docs", &[("host", "localhost")]),
            "host_not_allowed"
        );
        let twice = [("host", "localhost"), ("host", "localhost")];
        assert_eq!(code(&own, "GET", "/docs", &twice), "malformed_request");
        assert_eq!(code(&own, "GET", "/docs", &[]), "malformed_request");
    }

    #[test]
    fn hosts_of_a_service_for_others() {
        let open = origins("0.0.0.0:8080", &["quadmark"]);
        for (host, named) in [
            ("10.0.0.7:8080", true),
            ("[fe80::1]:8080", true),
            ("quadmark:8080", true),
            ("localhost", true),
            ("evil.test", false),
        ] {
            assert_eq!(of_host(&open, host), named, "{host}");
        }
        assert!(of_host(&origins("0.0.0.0:8080", &["*"]), "evil.test"));
    }

    #[test]
    fn sites_and_origins() {
        let own = origins("127.0.0.1:8080", &["marks.test"]);
        let with = |more: &[(&str, &str)]| {
            let headers = [&[("host", "127.0.0.1:8080")], more].concat();
            ["GET", "POST", "DELETE", "OPTIONS"].map(|method| code(&own, method, "/v1/x", &headers))
        };
        let fine: &[&[(&str, &str)]] = &[
            &[],
            &[(SITE, "none")],
            &[(SITE, "same-origin"), ("origin", "http://127.0.0.1:8080")],
            &[("origin", "http://127.0.0.1:8080")],
            // A proxy that speaks TLS and addresses the service by its address.
            &[("origin", "https://marks.test"), (SITE, "same-origin")],
            &[("origin", "http://marks.test")],
        ];
        for headers in fine {
            assert_eq!(with(headers), [""; 4], "{headers:?}");
        }
        let refused: &[&[(&str, &str)]] = &[
            &[(SITE, "cross-site")],
            &[(SITE, "same-site")],
            &[(SITE, "")],
            &[(SITE, "something-new")],
            &[("origin", "null")],
            &[("origin", "https://evil.test")],
            &[("origin", "http://127.0.0.1:3000")],
            &[("origin", "http://127.0.0.1")],
            &[("origin", "http://localhost:8080")],
            &[("origin", "https://marks.test:8443")],
            &[("origin", "file://")],
            &[("origin", "")],
            &[("origin", "http://127.0.0.1:8080"), ("origin", "http://evil.test")],
        ];
        for headers in refused {
            assert_eq!(with(headers), ["cross_origin"; 4], "{headers:?}");
        }
    }

    #[test]
    fn links_to_the_documentation_alone() {
        let own = origins("127.0.0.1:8080", &[]);
        let link = [
            ("host", "localhost:8080"),
            (SITE, "cross-site"),
            ("sec-fetch-mode", "navigate"),
            ("sec-fetch-dest", "document"),
        ];
        assert_eq!(code(&own, "GET", "/docs", &link), "");
        assert_eq!(code(&own, "GET", "/openapi.yaml", &link), "");
        for (method, path) in [("POST", "/docs"), ("GET", "/v1/watermarks"), ("GET", "/metrics")] {
            assert_eq!(code(&own, method, path, &link), "cross_origin", "{method} {path}");
        }
        let mut frame = link;
        frame[3].1 = "iframe";
        assert_eq!(code(&own, "GET", "/docs", &frame), "cross_origin");
    }
}
