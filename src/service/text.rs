//! Short texts from callers: owner, recipient, label.

use super::ServiceError;

/// Most characters of a text.
const LONGEST: usize = 256;

/// A text of 1 to 256 characters, without control characters and not only white space.
///
/// Control characters are refused because these texts appear in logs and headers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Text(String);

impl Text {
    /// Reads the value of `parameter`.
    ///
    /// # Errors
    /// [`ServiceError::InvalidParameter`].
    pub fn parse(parameter: &'static str, text: &str) -> Result<Self, ServiceError> {
        let refuse = |reason: &str| {
            Err(ServiceError::InvalidParameter { parameter, reason: reason.to_owned() })
        };
        if text.trim().is_empty() {
            return refuse("is empty; give 1 to 256 characters");
        }
        if text.chars().nth(LONGEST).is_some() {
            return refuse("is too long; give 1 to 256 characters");
        }
        if text.chars().any(char::is_control) {
            return refuse("holds a control character (such as a line break); leave it out");
        }
        Ok(Self(text.to_owned()))
    }

    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_control_characters() {
        let longest = "\u{e9}".repeat(256);
        let too_long = "a".repeat(257);
        let cases = [
            ("acme", true),
            ("A c-m_e \u{2764}", true),
            (longest.as_str(), true),
            (too_long.as_str(), false),
            ("", false),
            ("  ", false),
            ("a\nb", false),
            ("a\0b", false),
            ("a\u{85}b", false),
        ];
        for (text, fits) in cases {
            assert_eq!(Text::parse("owner_id", text).is_ok(), fits, "{text:?}");
        }
    }
}
