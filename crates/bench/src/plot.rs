//! Curves as SVG: axes, ticks, a legend; the same bytes for the same figures.

use std::fmt::Write as _;

/// Pixels of a plot and of its margins.
const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 230.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 52.0;
/// Told apart by most eyes, also without colour by their dashes (Okabe and Ito 2008).
const COLOURS: [&str; 8] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444", "#b0a000"];
const DASHES: [&str; 4] = ["", "6 3", "2 3", "8 3 2 3"];

/// A line of a plot.
#[derive(Clone, Debug)]
pub struct Series {
    /// What the legend says.
    pub name: String,
    /// Places, ascending in x.
    pub points: Vec<[f64; 2]>,
}

/// Curves over one axis.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    /// Above it.
    pub title: String,
    /// Below the x axis.
    pub x: String,
    /// Beside the y axis, which starts at 0.
    pub y: String,
    /// The curves, in the legend's order.
    pub series: Vec<Series>,
}

impl Plot {
    /// The plot as an SVG document. Places that are no numbers are left out.
    pub fn to_svg(&self) -> String {
        let places = || self.series.iter().flat_map(|s| &s.points).filter(|p| p.iter().all(|c| c.is_finite()));
        let fold = |of: usize, start: f64, pick: fn(f64, f64) -> f64| places().map(|p| p[of]).fold(start, pick);
        let (mut least, mut most) = (fold(0, f64::INFINITY, f64::min), fold(0, f64::NEG_INFINITY, f64::max));
        if least >= most {
            (least, most) = if least.is_finite() { (least - 0.5, least + 0.5) } else { (0.0, 1.0) };
        }
        let highest = fold(1, 0.0, f64::max);
        let step_y = step(if highest > 0.0 { highest } else { 1.0 }, 6.0);
        let top = (highest / step_y).ceil().max(1.0) * step_y;
        let at_x = |x: f64| LEFT + (x - least) / (most - least) * (WIDTH - LEFT - RIGHT);
        let at_y = |y: f64| HEIGHT - BOTTOM - y / top * (HEIGHT - TOP - BOTTOM);

        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#ffffff\"/>\n\
             <text x=\"{LEFT}\" y=\"22\" font-size=\"14\">{}</text>\n",
            escaped(&self.title)
        );
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for k in 0..=(top / step_y).round() as u32 {
            let value = f64::from(k) * step_y;
            let y = at_y(value);
            let _ = writeln!(out, "<path d=\"M{LEFT} {y:.1}H{right}\" stroke=\"#dddddd\"/>");
            let _ = writeln!(
                out,
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                LEFT - 6.0,
                y + 4.0,
                label(value, step_y)
            );
        }
        let step_x = step(most - least, 8.0);
        let mut k = (least / step_x - 1e-9).ceil();
        while k * step_x <= most + 1e-9 * step_x {
            let x = at_x(k * step_x);
            let _ = writeln!(out, "<path d=\"M{x:.1} {bottom}v5\" stroke=\"#444444\"/>");
            let _ = writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                bottom + 18.0,
                label(k * step_x, step_x)
            );
            k += 1.0;
        }
        let _ = writeln!(out, "<path d=\"M{LEFT} {TOP}V{bottom}H{right}\" fill=\"none\" stroke=\"#444444\"/>");
        let _ = writeln!(
            out,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            0.5 * (LEFT + right),
            HEIGHT - 14.0,
            escaped(&self.x)
        );
        let _ = writeln!(
            out,
            "<text transform=\"translate(18 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            0.5 * (TOP + bottom),
            escaped(&self.y)
        );
        for (k, series) in self.series.iter().enumerate() {
            let (colour, dash) = (COLOURS[k % COLOURS.len()], DASHES[k / 2 % DASHES.len()]);
            let style = format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\" stroke-dasharray=\"{dash}\"");
            let drawn: Vec<[f64; 2]> =
                series.points.iter().copied().filter(|p| p.iter().all(|c| c.is_finite())).collect();
            let line: Vec<String> = drawn.iter().map(|[x, y]| format!("{:.1},{:.1}", at_x(*x), at_y(*y))).collect();
            let _ = writeln!(out, "<polyline points=\"{}\" {style}/>", line.join(" "));
            for [x, y] in drawn {
                let _ =
                    writeln!(out, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.5\" fill=\"{colour}\"/>", at_x(x), at_y(y));
            }
            let y = TOP + 10.0 + 20.0 * k as f64;
            let _ = writeln!(out, "<path d=\"M{} {y}h28\" {style}/>", right + 14.0);
            let _ = writeln!(out, "<text x=\"{}\" y=\"{}\">{}</text>", right + 48.0, y + 4.0, escaped(&series.name));
        }
        out.push_str("</svg>\n");
        out
    }
}

/// A step of 1, 2 or 5 times a power of ten, so that `span` has at most `count` of them.
fn step(span: f64, count: f64) -> f64 {
    let least = span / count;
    let mut power = 1.0;
    while power > least {
        power /= 10.0;
    }
    while power * 10.0 <= least {
        power *= 10.0;
    }
    [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= least * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}

/// The value with as many decimals as its steps have.
fn label(value: f64, step: f64) -> String {
    let mut decimals = 0;
    let mut scaled = step;
    while (scaled - scaled.round()).abs() > 1e-6 && decimals < 9 {
        scaled *= 10.0;
        decimals += 1;
    }
    format!("{:.decimals$}", value + 0.0)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round_and_few() {
        for (span, count, expected) in
            [(1.0, 6.0, 0.2), (80.0, 8.0, 10.0), (6.0, 6.0, 1.0), (0.03, 6.0, 0.005), (7e5, 6.0, 2e5)]
        {
            assert!((step(span, count) / expected - 1.0).abs() < 1e-9, "{span}: {}", step(span, count));
        }
        assert_eq!(
            [label(0.6, 0.2), label(30.0, 10.0), label(0.025, 0.005), label(-0.0, 1.0)],
            ["0.6", "30", "0.025", "0"]
        );
    }

    #[test]
    fn every_curve_is_drawn_inside_the_axes_and_named() {
        let series = |name: &str, points: &[[f64; 2]]| Series { name: name.into(), points: points.to_vec() };
        let plot = Plot {
            title: "a < b & c".into(),
            x: "kept, %".into(),
            y: "RMSE".into(),
            series: vec![series("one", &[[10.0, 4.2], [90.0, 0.5]]), series("two", &[[10.0, f64::NAN], [90.0, 1.0]])],
        };
        let svg = plot.to_svg();
        assert!(svg.contains("a &lt; b &amp; c") && svg.contains(">one<") && svg.contains(">two<"));
        // 4.2 of 5 from 368 up to 40; 10 at the left, 90 at the right end.
        assert!(svg.contains("points=\"64.0,92.5 490.0,335.2\""), "{svg}");
        assert!(svg.contains("points=\"490.0,302.4\""), "{svg}");
        assert_eq!(svg.matches("<circle").count(), 3);
        assert_eq!(svg, plot.to_svg());
        assert!(Plot::default().to_svg().ends_with("</svg>\n"));
    }
}
