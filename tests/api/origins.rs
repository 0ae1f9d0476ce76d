//! Pages of other sites cannot use the service through its user's browser.

use quadmark::config::Settings;
use reqwest::Method;

use crate::server::{Server, file_form, obj, problem};

async fn send(
    server: &Server,
    method: Method,
    path: &str,
    headers: &[(&'static str, &str)],
) -> reqwest::Response {
    let mut request = server.client.request(method.clone(), server.url(path));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    if method == Method::POST {
        let form = file_form(obj());
        let marks = path == "/v1/watermarks";
        request = request.multipart(if marks { form.text("owner_id", "acme") } else { form });
    }
    request.send().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn other_sites_read_nothing_and_change_nothing() {
    let server = Server::start().await;
    let foreign: &[&[(&'static str, &str)]] = &[
        &[("origin", "https://evil.test")],
        &[("origin", "null")],
        &[("origin", "http://localhost:3000"), ("sec-fetch-site", "same-site")],
        &[("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "no-cors")],
    ];
    for headers in foreign {
        for (method, path) in [
            (Method::POST, "/v1/watermarks"),
            (Method::POST, "/v1/verifications"),
            (Method::POST, "/v1/inspections"),
            (Method::GET, "/v1/watermarks"),
            (Method::DELETE, "/v1/watermarks/0198f000-0000-7000-8000-000000000000"),
            (Method::OPTIONS, "/v1/watermarks"),
            (Method::GET, "/metrics"),
            (Method::GET, "/docs"),
            (Method::GET, "/nowhere"),
        ] {
            problem(send(&server, method, path, headers).await, 403, "cross_origin").await;
        }
    }
    // A page whose name was rebound to this address has the same origin for its browser.
    let rebound = [
        ("host", "evil.test:8080"),
        ("origin", "http://evil.test:8080"),
        ("sec-fetch-site", "same-origin"),
    ];
    for (method, path) in [(Method::POST, "/v1/watermarks"), (Method::GET, "/v1/watermarks")] {
        let refused = problem(send(&server, method, path, &rebound).await, 421, "host_not_allowed");
        assert!(refused.await["detail"].as_str().unwrap().contains("--allowed-hosts"));
    }
    server.assert_empty("requests of other sites").await;
    // Probes are answered under any address.
    for path in ["/livez", "/readyz"] {
        assert_eq!(send(&server, Method::GET, path, &rebound).await.status(), 200);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn programs_own_pages_and_links_to_the_documentation_work() {
    let server = Server::start().await;
    assert_eq!(send(&server, Method::POST, "/v1/watermarks", &[]).await.status(), 201);
    let own = format!("http://{}", server.address);
    let page = [("origin", own.as_str()), ("sec-fetch-site", "same-origin")];
    assert_eq!(send(&server, Method::POST, "/v1/verifications", &page).await.status(), 200);
    let typed = [("sec-fetch-site", "none"), ("sec-fetch-mode", "navigate")];
    assert_eq!(send(&server, Method::GET, "/v1/watermarks", &typed).await.status(), 200);
    let link = [
        ("sec-fetch-site", "cross-site"),
        ("sec-fetch-mode", "navigate"),
        ("sec-fetch-dest", "document"),
    ];
    let docs = send(&server, Method::GET, "/docs", &link).await;
    assert_eq!(docs.status(), 200);
    assert_eq!(docs.headers()["cross-origin-resource-policy"], "same-origin");
    problem(send(&server, Method::GET, "/v1/watermarks", &link).await, 403, "cross_origin").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn names_of_the_settings_are_known() {
    let names = Some(vec!["marks.test".to_owned()]);
    let server = Server::with(Settings { allowed_hosts: names, ..Settings::default() }).await;
    let page = [
        ("host", "marks.test"),
        ("origin", "https://marks.test"),
        ("sec-fetch-site", "same-origin"),
    ];
    assert_eq!(send(&server, Method::POST, "/v1/verifications", &page).await.status(), 200);
    // A proxy that uses the address.
    assert_eq!(send(&server, Method::POST, "/v1/verifications", &page[1..]).await.status(), 200);
    let other = [("host", "other.test")];
    problem(send(&server, Method::GET, "/docs", &other).await, 421, "host_not_allowed").await;
}
