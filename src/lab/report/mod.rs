//! The results of a run as one self-contained page with tables, plots and renderings. Nothing is
//! loaded from elsewhere.
//!
//! Must not decide what is run nor write files.

mod claims;
pub(super) mod figures;
mod paper;
mod picture;
mod plot;
mod raster;
mod reasons;
mod table;
mod tables;
#[cfg(test)]
mod test_support;

use std::fmt::Write as _;

use super::grid::Grid;
use super::summary::Group;
use plot::escaped;

pub use figures::Figure;
pub use picture::{Gallery, Picture, galleries};
pub use plot::Plot;
pub use table::Table;

/// The content of a page.
#[derive(Debug, Clone, Copy)]
pub struct Report<'a> {
    /// The grid that was run.
    pub grid: Grid,
    /// Requested number of trials.
    pub trials: usize,
    /// The seed.
    pub seed: u64,
    /// The decimal logarithm below which a bound is a match.
    pub threshold: f64,
    /// Whether all trials were run.
    pub complete: bool,
    /// The results.
    pub groups: &'a [Group],
    /// The renderings.
    pub galleries: &'a [Gallery],
}

/// Colours and sizes. The page is light because the renderings are.
const STYLE: &str = "body{font:15px/1.45 sans-serif;color:#222;background:#fff;max-width:1500px;\
    margin:2em auto;padding:0 1em}h1{font-size:1.5em}h2{margin-top:2em;border-bottom:1px solid \
    #ccc}table{border-collapse:collapse;font-size:13px}td,th{border:1px solid #ccc;padding:3px \
    7px;text-align:left;white-space:nowrap}th{background:#f3f3f3}td.long{white-space:\
    normal;min-width:26em;max-width:60em}.wide{overflow-x:auto}.note{\
    color:#555;font-size:13px;max-width:80ch}.row{display:flex;flex-wrap:wrap;gap:14px}figure{\
    margin:0}figcaption{font-size:12px;max-width:340px;color:#444}img{width:340px;height:340px;\
    border:1px solid #eee}";

impl Report<'_> {
    /// The figures. Each is also kept as a file of its own.
    #[must_use]
    pub fn figures(&self) -> Vec<Figure> {
        figures::figures(self.grid, self.groups)
    }

    /// The tables as Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let tables = tables::tables(self.grid, self.groups);
        tables.iter().map(Table::markdown).collect::<Vec<_>>().join("\n")
    }

    /// The page.
    #[must_use]
    pub fn html(&self) -> String {
        let mut page = format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
             <title>quadmark lab: {0}</title>\n<style>{STYLE}</style></head>\n<body>\n\
             <h1>quadmark lab, grid {0}</h1>\n<p>Up to {1} trials per mark, seed {2}; a match is a \
             false-positive bound below 10<sup>{3}</sup> for one record. Version {4}.{5}</p>\n",
            self.grid.name(),
            self.trials,
            self.seed,
            self.threshold,
            env!("CARGO_PKG_VERSION"),
            if self.complete { "" } else { " <b>Ended early: means are over fewer trials.</b>" }
        );
        self.pictures(&mut page);
        page.push_str("<h2>Tables</h2>\n");
        for table in tables::tables(self.grid, self.groups) {
            page.push_str(&table.html());
        }
        let figures = self.figures();
        if !figures.is_empty() {
            page.push_str("<h2>Figures</h2>\n<div class=\"row\">\n");
            for figure in &figures {
                page.push_str(&figure.plot.svg());
            }
            page.push_str("</div>\n");
        }
        page.push_str("</body></html>\n");
        page
    }

    // Writing to a String cannot fail.
    fn pictures(&self, page: &mut String) {
        for gallery in self.galleries {
            let _ = writeln!(page, "<h2>{}</h2>\n<div class=\"row\">", escaped(&gallery.mesh));
            for Picture { caption, uri } in &gallery.pictures {
                let caption = escaped(caption);
                let _ = writeln!(
                    page,
                    "<figure><img alt=\"{caption}\" src=\"{uri}\"><figcaption>{caption}\
                     </figcaption></figure>"
                );
            }
            page.push_str("</div>\n");
        }
    }
}
