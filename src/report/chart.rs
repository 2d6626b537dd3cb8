//! Line charts as SVG.

use maud::{Markup, html};

/// A line.
#[derive(Debug, Clone)]
pub struct Series {
    /// Points in data coordinates.
    pub points: Vec<[f64; 2]>,
    /// CSS colour.
    pub color: String,
}

/// A shaded range of x.
#[derive(Debug, Clone)]
pub struct Band {
    /// From and to, in data coordinates.
    pub range: [f64; 2],
    /// Class of the rectangle, which gives its colour.
    pub class: &'static str,
    /// Tooltip.
    pub name: String,
}

/// A horizontal line with a name.
#[derive(Debug, Clone)]
pub struct Level {
    /// Where.
    pub y: f64,
    /// Label.
    pub name: String,
}

/// A chart with one pair of axes.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Heading inside the picture.
    pub title: String,
    /// Width and height, pixels of the drawing.
    pub size: [f64; 2],
    /// Unit or name of x; none where it is told elsewhere.
    pub x_label: &'static str,
    /// True for a logarithmic y axis; values must then be positive.
    pub logarithmic: bool,
    /// Shaded ranges.
    pub bands: Vec<Band>,
    /// Lines.
    pub series: Vec<Series>,
    /// Marked values. Those far outside the data are not drawn on linear axes.
    pub levels: Vec<Level>,
}

const LEFT: f64 = 46.0;
const RIGHT: f64 = 8.0;
const TOP: f64 = 24.0;
const BOTTOM: f64 = 18.0;
/// Smallest span of a linear y axis, so that constant joints are flat lines and not noise.
const LEAST_SPAN: f64 = 0.02;

impl Chart {
    /// The SVG element.
    pub fn draw(&self) -> Markup {
        let [width, height] = self.size;
        let bottom = BOTTOM + if self.x_label.is_empty() { 0.0 } else { 14.0 };
        let (x_range, y_range) = (self.x_range(), self.y_range());
        let x = |value: f64| {
            LEFT + (value - x_range[0]) / (x_range[1] - x_range[0]) * (width - LEFT - RIGHT)
        };
        let scale = |value: f64| if self.logarithmic { value.max(1e-300).log10() } else { value };
        let [low, high] = y_range.map(scale);
        let y = |value: f64| {
            height - bottom - (scale(value) - low) / (high - low) * (height - TOP - bottom)
        };
        let y_ticks = if self.logarithmic { decades(y_range) } else { ticks(y_range, 4) };
        let visible = |level: &&Level| (y_range[0]..=y_range[1]).contains(&level.y);
        html! {
            svg.chart viewBox=(format!("0 0 {width} {height}")) role="img" aria-label=(self.title) {
                @for band in &self.bands {
                    rect class=(band.class) x=(px(x(band.range[0]))) y=(px(TOP))
                        width=(px(x(band.range[1]) - x(band.range[0])))
                        height=(px(height - TOP - bottom)) { title { (band.name) } }
                }
                @for value in y_ticks {
                    line.grid x1=(px(LEFT)) x2=(px(width - RIGHT)) y1=(px(y(value))) y2=(px(y(value))) {}
                    text.tick text-anchor="end" x=(px(LEFT - 5.0)) y=(px(y(value) + 3.5)) { (number(value)) }
                }
                @for value in ticks(x_range, (width / 70.0) as usize) {
                    text.tick text-anchor="middle" x=(px(x(value))) y=(px(height - bottom + 13.0)) { (number(value)) }
                }
                @for series in &self.series {
                    polyline.line style=(format!("stroke:{}", series.color))
                        points=(points(series.points.iter().map(|p| [x(p[0]), y(p[1])]))) {}
                }
                @for level in self.levels.iter().filter(visible) {
                    line.level x1=(px(LEFT)) x2=(px(width - RIGHT)) y1=(px(y(level.y))) y2=(px(y(level.y))) {}
                    text.level-name text-anchor="end" x=(px(width - RIGHT - 3.0)) y=(px(y(level.y) - 4.0)) { (level.name) }
                }
                text.title x=(px(LEFT)) y="13" { (self.title) }
                @if !self.x_label.is_empty() {
                    text.tick text-anchor="middle" x=(px((LEFT + width - RIGHT) / 2.0)) y=(px(height - 4.0)) { (self.x_label) }
                }
            }
        }
    }

    fn values(&self, axis: usize) -> impl Iterator<Item = f64> + '_ {
        self.series.iter().flat_map(|series| &series.points).map(move |point| point[axis])
    }

    fn x_range(&self) -> [f64; 2] {
        let bands = self.bands.iter().flat_map(|band| band.range);
        let [low, high] = range(self.values(0).chain(bands));
        if high > low { [low, high] } else { [low, low + 1.0] }
    }

    fn y_range(&self) -> [f64; 2] {
        if self.logarithmic {
            let levels = self.levels.iter().map(|level| level.y);
            let [low, high] = range(self.values(1).chain(levels).filter(|&v| v > 0.0));
            let high = if high > low { high } else { low * 10.0 };
            return [10f64.powf(low.log10().floor()), 10f64.powf((high.log10() + 0.15).ceil())];
        }
        let [low, high] = range(self.values(1));
        let middle = (low + high) / 2.0;
        let half = ((high - low) * 0.54).max(LEAST_SPAN / 2.0);
        [middle - half, middle + half]
    }
}

/// Smallest and largest value; `[0, 1]` of none.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let finite = values.filter(|value| value.is_finite());
    let found = finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        [low.min(value), high.max(value)]
    });
    if found[0] <= found[1] { found } else { [0.0, 1.0] }
}

/// About `count` round numbers within a range.
pub fn ticks([low, high]: [f64; 2], count: usize) -> Vec<f64> {
    let raw = (high - low) / count.max(1) as f64;
    if !raw.is_finite() || raw <= 0.0 {
        return Vec::new();
    }
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|&step| step >= raw);
    let step = step.unwrap_or(raw);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

/// Powers of ten within a range, at most about six.
fn decades([low, high]: [f64; 2]) -> Vec<f64> {
    let (first, last) = (low.log10().round() as i32, high.log10().round() as i32);
    let step = ((last - first) / 6 + 1).max(1) as usize;
    (first..=last).rev().step_by(step).map(|power| 10f64.powi(power)).collect()
}

/// A number as short as its ticks need it.
pub fn number(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude > 0.0 && magnitude < 1e-3 {
        return format!("{value:.0e}");
    }
    let text = format!("{value:.3}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".into() } else { short.into() }
}

/// A coordinate with a tenth of a pixel.
pub fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").unwrap_or(&text).to_owned()
}

/// The `points` of a polyline.
pub fn points(points: impl Iterator<Item = [f64; 2]>) -> String {
    let pairs: Vec<String> = points.map(|[x, y]| format!("{},{}", px(x), px(y))).collect();
    pairs.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks([0.0, 1.0], 4), [0.0, 0.5, 1.0]);
        assert_eq!(ticks([-0.31, 0.27], 4).len(), 3);
        assert!(ticks([0.0, 0.0], 4).is_empty());
        assert_eq!(decades([1e-6, 1.0]), [1.0, 1e-2, 1e-4, 1e-6]);
    }

    #[test]
    fn numbers_are_short() {
        let shown = [0.5, -0.0, 12.0, 1e-6, 0.125].map(number);
        assert_eq!(shown, ["0.5", "0", "12", "1e-6", "0.125"]);
    }

    #[test]
    fn names_are_escaped_and_coordinates_finite() {
        let chart = Chart {
            title: "<script>&\"".into(),
            size: [320.0, 120.0],
            series: vec![Series { points: vec![[0.0, 1.0], [0.0, 1.0]], color: "red".into() }],
            levels: vec![Level { y: 1.0, name: "a<b".into() }],
            ..Chart::default()
        };
        for logarithmic in [false, true] {
            let svg = Chart { logarithmic, ..chart.clone() }.draw().into_string();
            assert!(!svg.contains("<script") && svg.contains("&lt;script&gt;&amp;&quot;"), "{svg}");
            assert!(svg.contains("a&lt;b"), "{svg}");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }
}
