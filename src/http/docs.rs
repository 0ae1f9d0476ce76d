//! The page at `/docs`: operations and error codes, from the same sources as the `OpenAPI`
//! document.
//!
//! It is self-contained: no script, no font, nothing from other hosts.

use std::fmt::Write;

use super::code::Code;
use super::document::document;

const HEAD: &str = "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
<meta name=\"viewport\" content=\"width=device-width\"><title>quadmark</title><style>\
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;\
color:#1a1a1a;background:#fff}\
code,pre{font-family:ui-monospace,monospace;font-size:.9em}\
pre{background:#f4f4f4;padding:1rem;overflow:auto}\
table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.3rem .6rem;\
border-bottom:1px solid #ddd;vertical-align:top}\
tr:target{background:#fff3c4}\
@media(prefers-color-scheme:dark){body{color:#eee;background:#161616}pre{background:#242424}\
td,th{border-color:#444}tr:target{background:#4a3f10}a{color:#9cf}}\
</style></head><body><h1>quadmark</h1>";

const EXAMPLES: &str = "<pre>curl -F file=@mesh.obj -F owner_id=acme -o marked.obj \
http://127.0.0.1:8080/v1/watermarks\n\
curl -F file=@marked.obj http://127.0.0.1:8080/v1/verifications</pre>";

/// The page as HTML.
pub(super) fn docs_page() -> String {
    let document = document();
    let mut page = String::with_capacity(16 << 10);
    page.push_str(HEAD);
    // Writing to a String cannot fail.
    let _ = write!(
        page,
        "<p>{}</p><p>The whole contract: <a href=\"/openapi.yaml\">/openapi.yaml</a>.</p>",
        escape(document.info.description.as_deref().unwrap_or_default())
    );
    page.push_str(EXAMPLES);
    page.push_str("<h2>Operations</h2><table><tr><th>Request</th><th>Does</th></tr>");
    for (path, item) in &document.paths.paths {
        let operations = [("GET", &item.get), ("POST", &item.post), ("DELETE", &item.delete)];
        for (method, operation) in operations {
            let Some(operation) = operation else { continue };
            let does = operation.summary.as_deref().unwrap_or_default();
            let _ = write!(
                page,
                "<tr><td><code>{method}&nbsp;{}</code></td><td>{}</td></tr>",
                escape(path),
                escape(does)
            );
        }
    }
    page.push_str(
        "</table><h2>Error codes</h2><table><tr><th>Code</th><th>Status</th><th>Means</th></tr>",
    );
    for code in Code::ALL {
        let name = code.name();
        let _ = write!(
            page,
            "<tr id=\"{name}\"><td><code>{name}</code></td><td>{}</td><td>{}</td></tr>",
            code.status().as_u16(),
            escape(code.title())
        );
    }
    page.push_str("</table></body></html>\n");
    page
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_listed_and_nothing_is_loaded() {
        let page = docs_page();
        for word in ["/v1/watermarks/{id}/file", "DELETE", "insufficient_capacity", "/readyz"] {
            assert!(page.contains(word), "{word}");
        }
        for word in ["<script", "<link", "src=", "https://"] {
            assert!(!page.contains(word), "{word}");
        }
    }
}
