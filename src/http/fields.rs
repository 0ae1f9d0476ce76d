//! The text fields of a request. Each must be known, given once, and valid for its type.

use std::collections::BTreeMap;

use super::code::Code;
use super::error::ApiError;
use super::upload::listed;
use crate::service::Text;

/// Fields by name.
#[derive(Debug)]
pub(super) struct Fields {
    known: &'static [&'static str],
    values: BTreeMap<String, String>,
}

impl Fields {
    pub(super) fn new(
        known: &'static [&'static str],
        query: Vec<(String, String)>,
    ) -> Result<Self, ApiError> {
        let mut fields = Self { known, values: BTreeMap::new() };
        for (name, value) in query {
            fields.add(name, value)?;
        }
        Ok(fields)
    }

    /// Adds a field; refuses an unknown field and a second value.
    pub(super) fn add(&mut self, name: String, value: String) -> Result<(), ApiError> {
        if !self.known.contains(&name.as_str()) {
            let name: String = name.chars().take(40).collect();
            let all = listed(self.known);
            let text = format!("there is no field {name:?} here; the fields are file, {all}");
            return Err(ApiError::new(Code::UnknownParameter, text));
        }
        if self.values.contains_key(&name) {
            let text = format!("{name} is given twice; send it once");
            return Err(ApiError::new(Code::DuplicateParameter, text));
        }
        self.values.insert(name, value);
        Ok(())
    }

    /// The field, parsed; `None` if it is not given.
    pub(super) fn parsed<T, E: std::fmt::Display>(
        &self,
        name: &'static str,
        parse: impl FnOnce(&str) -> Result<T, E>,
    ) -> Result<Option<T>, ApiError> {
        let parsed = self.values.get(name).map(|text| parse(text)).transpose();
        parsed.map_err(|error| ApiError::new(Code::InvalidParameter, format!("{name}: {error}")))
    }

    /// A short text.
    pub(super) fn text(&self, name: &'static str) -> Result<Option<Text>, ApiError> {
        let text = self.values.get(name).map(|text| Text::parse(name, text)).transpose();
        text.map_err(ApiError::from)
    }

    /// A short text that must be given.
    pub(super) fn required_text(&self, name: &'static str) -> Result<Text, ApiError> {
        self.text(name)?.ok_or_else(|| {
            let text = format!(
                "{name} is missing; add it as a form field (curl -F {name}=acme), or to the query \
                 when the body is the file itself (?{name}=acme)"
            );
            ApiError::new(Code::MissingParameter, text)
        })
    }

    /// A field that is `true`, `1`, `false` or `0`, in any case: clients generated for Python send
    /// `True`.
    pub(super) fn flag(&self, name: &'static str, default: bool) -> Result<bool, ApiError> {
        let flag = self.parsed(name, |text| match text.to_ascii_lowercase().as_str() {
            "true" | "1" => Ok(true),
            "false" | "0" => Ok(false),
            _ => Err("must be true or false"),
        })?;
        Ok(flag.unwrap_or(default))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: &[&str] = &["owner_id", "keep_file"];

    #[test]
    fn known_once_and_typed() {
        let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        assert!(Fields::new(KNOWN, vec![pair("owner", "x")]).is_err());
        assert!(Fields::new(KNOWN, vec![pair("owner_id", "x"), pair("owner_id", "x")]).is_err());
        let fields =
            Fields::new(KNOWN, vec![pair("owner_id", "x"), pair("keep_file", "maybe")]).unwrap();
        assert_eq!(fields.required_text("owner_id").unwrap().as_str(), "x");
        assert!(fields.flag("keep_file", true).is_err());
        let python = Fields::new(KNOWN, vec![pair("keep_file", "False")]).unwrap();
        assert!(!python.flag("keep_file", true).unwrap());
        let none = Fields::new(KNOWN, Vec::new()).unwrap();
        assert!(none.required_text("owner_id").is_err());
        assert!(none.flag("keep_file", true).unwrap());
    }
}
