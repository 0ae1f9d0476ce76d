//! Tables, for the report and as Markdown.

use std::fmt::Write as _;

use super::plot::escaped;

/// A cell.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cell {
    /// Its text.
    pub text: String,
    /// How good the value is, from 0 to 1. It sets the background.
    pub merit: Option<f64>,
}

impl Cell {
    /// A cell that is neither good nor bad.
    pub fn plain(text: impl Into<String>) -> Self {
        Self { text: text.into(), merit: None }
    }

    /// A cell with a background.
    pub fn rated(text: impl Into<String>, merit: f64) -> Self {
        Self { text: text.into(), merit: Some(merit.clamp(0.0, 1.0)) }
    }
}

/// Number of characters beyond which a cell is broken into lines.
const LONG: usize = 60;

/// A table.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Title above the table.
    pub title: String,
    /// Note below the table.
    pub note: String,
    /// Column heads.
    pub head: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// As HTML.
    #[must_use]
    pub fn html(&self) -> String {
        let mut html =
            format!("<h3>{}</h3>\n<div class=\"wide\"><table><tr>", escaped(&self.title));
        // Writing to a String cannot fail, here and below.
        for head in &self.head {
            let _ = write!(html, "<th>{}</th>", escaped(head));
        }
        html.push_str("</tr>\n");
        for row in &self.rows {
            html.push_str("<tr>");
            for cell in row {
                // From red through yellow to green.
                let style = cell.merit.map_or_else(String::new, |merit| {
                    format!(" style=\"background:hsl({:.0} 70% 88%)\"", 120.0 * merit)
                });
                let class = if cell.text.chars().count() > LONG { " class=\"long\"" } else { "" };
                let _ = write!(html, "<td{class}{style}>{}</td>", escaped(&cell.text));
            }
            html.push_str("</tr>\n");
        }
        let _ = writeln!(html, "</table></div>\n<p class=\"note\">{}</p>", escaped(&self.note));
        html
    }

    /// As Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let safe = |text: &str| text.replace('|', "\\|");
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let mut text = format!("**{}**\n\n", self.title);
        text += &line(self.head.iter().map(|head| safe(head)).collect());
        text += &line(vec!["---".to_owned(); self.head.len()]);
        for row in &self.rows {
            text += &line(row.iter().map(|cell| safe(&cell.text)).collect());
        }
        let _ = writeln!(text, "\n{}\n", self.note);
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_cannot_break_out() {
        let table = Table {
            title: "a".into(),
            note: "n".into(),
            head: vec!["<b>".into()],
            rows: vec![vec![Cell::rated("x|<img>", 2.0)]],
        };
        assert!(!table.html().contains("<img>") && table.html().contains("hsl(120 "));
        assert!(table.markdown().contains("x\\|<img>"));
    }
}
