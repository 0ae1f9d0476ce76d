//! Properties that the whole document must have.

use serde_json::Value;

use super::super::document::document;
use super::*;

/// Codes of requests with a method that the path does not have: they belong to no operation.
const NOWHERE: &[Code] = &[Code::MethodNotAllowed];

fn json() -> Value {
    serde_json::to_value(document()).unwrap()
}

fn operations(document: &Value) -> Vec<&Value> {
    let paths = document["paths"].as_object().unwrap().values();
    paths.flat_map(|item| item.as_object().unwrap().values()).collect()
}

/// A code that is in none of the tables is not documented: add it to the tables of the operations
/// that answer with it.
#[test]
fn every_code_is_of_some_operation() {
    let document = json();
    let text: String = operations(&document).iter().map(ToString::to_string).collect();
    for code in Code::ALL.iter().filter(|code| !NOWHERE.contains(code)) {
        assert!(text.contains(&format!("`{}`", code.name())), "{}", code.name());
    }
    let names = &document["components"]["schemas"]["Code"]["enum"];
    assert_eq!(names.as_array().unwrap().len(), Code::ALL.len());
}

#[test]
fn bytes_are_binary_and_uploads_come_in_two_forms() {
    let document = json();
    assert!(!document.to_string().contains("int32\",\"minimum\":0},\"type\":\"array\""));
    for operation in operations(&document) {
        for response in operation["responses"].as_object().unwrap().values() {
            for (kind, content) in response["content"].as_object().into_iter().flatten() {
                let binary = content["schema"]["format"] == "binary";
                assert_eq!(binary, kind.starts_with("model/"), "{kind}: {content}");
            }
        }
        let body = &operation["requestBody"]["content"];
        let Some(form) = body["multipart/form-data"]["schema"]["$ref"].as_str() else {
            continue;
        };
        assert_eq!(body["application/octet-stream"]["schema"]["format"], "binary");
        let form = &document["components"]["schemas"][form.rsplit('/').next().unwrap()];
        for (name, field) in form["properties"].as_object().unwrap() {
            assert!(!field.to_string().contains("null"), "{name}: {field}");
            let asked = operation["parameters"].as_array().unwrap();
            let asked = asked.iter().filter(|p| p["in"] == "query" && p["name"] == name.as_str());
            assert_eq!(asked.count(), usize::from(name != "file"), "{name}");
        }
    }
}

#[test]
fn links_lead_to_operations_that_are_there() {
    let document = json();
    let all = operations(&document);
    let ids: Vec<&Value> = all.iter().map(|operation| &operation["operationId"]).collect();
    let mut found = 0;
    for operation in &all {
        for response in operation["responses"].as_object().unwrap().values() {
            for link in response["links"].as_object().into_iter().flat_map(|l| l.values()) {
                assert!(ids.contains(&&link["operationId"]), "{link}");
                found += 1;
            }
        }
    }
    assert_eq!(found, 4);
}
