//! Line plots as SVG, without scripts, fonts or external content.

use std::fmt::Write as _;

/// One curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// Index into [`COLOURS`].
    pub colour: usize,
    /// Whether its line is dashed.
    pub dashed: bool,
    /// Points by ascending x.
    pub points: Vec<(f64, f64)>,
}

/// An axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it shows, with the unit.
    pub label: String,
    /// Start and end; the start may be the larger.
    pub range: (f64, f64),
    /// Values with a tick and a number.
    pub ticks: Vec<f64>,
}

/// A plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// Title above the plot.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// The curves.
    pub series: Vec<Series>,
}

/// Okabe and Ito's colours, which colour-blind readers can distinguish (*Color universal design*,
/// 2008).
pub const COLOURS: [&str; 7] =
    ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#555555"];

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 44.0;
/// Height of a line of the legend.
const LINE: f64 = 15.0;

impl Axis {
    /// An axis over `values`, ascending, with ticks at them all.
    #[must_use]
    pub fn through(label: &str, values: &[f64]) -> Self {
        let start = (f64::INFINITY, f64::NEG_INFINITY);
        let range = values.iter().fold(start, |(low, high), &v| (low.min(v), high.max(v)));
        Self { label: label.into(), range, ticks: values.to_vec() }
    }

    /// An axis from 0 to a round number at or above `highest`.
    #[must_use]
    pub fn from_zero(label: &str, highest: f64) -> Self {
        let step = round_step(highest / 4.0);
        let steps = (highest / step - 1e-9).ceil().max(1.0);
        let ticks = std::iter::successors(Some(0.0), |k| Some(k + 1.0));
        let ticks = ticks.take_while(|&k| k <= steps).map(|k| k * step).collect();
        Self { label: label.into(), range: (0.0, steps * step), ticks }
    }

    fn share(&self, value: f64) -> f64 {
        let (from, to) = self.range;
        let share = (value - from) / (to - from);
        // The axis has a single value.
        if share.is_finite() { share } else { 0.5 }
    }
}

/// 1, 2 or 5 times a power of ten, at or above `step`.
fn round_step(step: f64) -> f64 {
    if !(step > 0.0 && step.is_finite()) {
        return 1.0;
    }
    let power = libm::pow(10.0, step.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|k| k * power);
    steps.into_iter().find(|&s| s >= step * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}

/// A number with as few digits as it needs, at most four after the point.
#[must_use]
pub fn short(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// Text made safe for XML.
#[must_use]
pub fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            _ => safe.push(letter),
        }
    }
    safe
}

impl Plot {
    /// The plot as an SVG document.
    #[must_use]
    pub fn svg(&self) -> String {
        let legend = LINE * self.series.len().div_ceil(2) as f64 + 8.0;
        let height = HEIGHT + legend;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" \
             width=\"{WIDTH}\" height=\"{height}\" font-family=\"sans-serif\" font-size=\"11\" \
             fill=\"#222\" role=\"img\">\n<title>{0}</title>\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n\
             <text x=\"{LEFT}\" y=\"18\" font-size=\"13\" font-weight=\"bold\">{0}</text>\n",
            escaped(&self.title)
        );
        self.axes(&mut svg);
        for series in &self.series {
            self.curve(&mut svg, series);
        }
        self.legend(&mut svg);
        svg.push_str("</svg>\n");
        svg
    }

    fn x_at(&self, value: f64) -> f64 {
        LEFT + self.x.share(value) * (WIDTH - LEFT - RIGHT)
    }

    fn y_at(&self, value: f64) -> f64 {
        HEIGHT - BOTTOM - self.y.share(value).clamp(0.0, 1.0) * (HEIGHT - TOP - BOTTOM)
    }

    // Writing to a String cannot fail, here and below.
    fn axes(&self, svg: &mut String) {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for &tick in &self.y.ticks {
            let y = self.y_at(tick);
            let _ = writeln!(
                svg,
                "<path d=\"M{LEFT} {y:.1}H{right}\" stroke=\"#ddd\"/><text x=\"{:.1}\" \
                 y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                LEFT - 5.0,
                y + 4.0,
                short(tick)
            );
        }
        let mut last = f64::NEG_INFINITY;
        for &tick in &self.x.ticks {
            let x = self.x_at(tick);
            let _ = writeln!(svg, "<path d=\"M{x:.1} {bottom}v4\" stroke=\"#222\"/>");
            // Numbers that would overlap are left out.
            if (x - last).abs() > 24.0 {
                let y = bottom + 16.0;
                let _ = writeln!(
                    svg,
                    "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{}</text>",
                    short(tick)
                );
                last = x;
            }
        }
        let _ = writeln!(
            svg,
            "<path d=\"M{LEFT} {TOP}V{bottom}H{right}\" fill=\"none\" stroke=\"#222\"/>\n\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\n\
             <text transform=\"translate(14 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            f64::midpoint(LEFT, right),
            bottom + 34.0,
            escaped(&self.x.label),
            f64::midpoint(TOP, bottom),
            escaped(&self.y.label)
        );
    }

    fn curve(&self, svg: &mut String, series: &Series) {
        let colour = COLOURS[series.colour % COLOURS.len()];
        let dash = if series.dashed { " stroke-dasharray=\"5 3\"" } else { "" };
        let mut path = String::new();
        for (k, &(x, y)) in series.points.iter().enumerate() {
            let (x, y) = (self.x_at(x), self.y_at(y));
            let _ = write!(path, "{}{x:.1} {y:.1}", if k == 0 { 'M' } else { 'L' });
            let _ =
                writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.6\" fill=\"{colour}\"/>");
        }
        let _ = writeln!(
            svg,
            "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.7\"{dash}/>"
        );
    }

    fn legend(&self, svg: &mut String) {
        for (k, series) in self.series.iter().enumerate() {
            let x = LEFT + (k % 2) as f64 * (WIDTH - LEFT - RIGHT) / 2.0;
            let y = HEIGHT + 6.0 + (k / 2) as f64 * LINE;
            let colour = COLOURS[series.colour % COLOURS.len()];
            let dash = if series.dashed { " stroke-dasharray=\"5 3\"" } else { "" };
            let _ = writeln!(
                svg,
                "<path d=\"M{x:.1} {y:.1}h22\" stroke=\"{colour}\" stroke-width=\"2\"{dash}/>\
                 <text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                x + 28.0,
                y + 4.0,
                escaped(&series.name)
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_end_at_round_numbers() {
        for (highest, end, ticks) in [(0.93, 1.0, 3), (7.0, 8.0, 5), (0.0, 1.0, 2), (1e-4, 1e-4, 3)]
        {
            let axis = Axis::from_zero("y", highest);
            assert!((axis.range.1 - end).abs() < 1e-12, "{highest}: {:?}", axis.range);
            assert!(axis.ticks.len() >= ticks, "{highest}: {:?}", axis.ticks);
            assert!(axis.range.1 >= highest * (1.0 - 1e-9));
        }
    }

    #[test]
    fn the_picture_holds_every_point_inside_and_no_live_markup() {
        let series = Series {
            name: "<script>".into(),
            colour: 0,
            dashed: true,
            points: vec![(12.0, 1.0), (9.0, 0.7), (7.0, 0.5)],
        };
        let x = Axis { label: "bits & such".into(), range: (12.0, 7.0), ticks: vec![12.0, 7.0] };
        let plot =
            Plot { title: "a < b".into(), x, y: Axis::from_zero("y", 1.0), series: vec![series] };
        let svg = plot.svg();
        assert_eq!(svg.matches("<circle").count(), 3);
        assert!(!svg.contains("<script>") && svg.contains("&lt;script&gt;"));
        assert!(svg.contains("a &lt; b") && svg.contains("bits &amp; such"));
        // Reversed: 12 at the left.
        assert!(plot.x_at(12.0) < plot.x_at(7.0));
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in [(0.5, "0.5"), (10.0, "10"), (-0.00001, "0"), (97.5, "97.5")] {
            assert_eq!(short(value), text);
        }
    }
}
