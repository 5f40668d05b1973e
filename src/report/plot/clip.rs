//! The parts of lines within a panel.

pub(super) type Point = (f64, f64);

/// The part of a segment within left, top, right and bottom of a panel (Liang and Barsky 1984). An end within the panel stays exactly the same.
pub(super) fn segment(
    from: Point,
    to: Point,
    [left, top, right, bottom]: [f64; 4],
) -> Option<(Point, Point)> {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let (mut first, mut last) = (0.0_f64, 1.0_f64);
    let edges = [
        (-dx, from.0 - left),
        (dx, right - from.0),
        (-dy, from.1 - top),
        (dy, bottom - from.1),
    ];
    for (outwards, distance) in edges {
        if outwards < 0.0 {
            first = first.max(distance / outwards);
        } else if outwards > 0.0 {
            last = last.min(distance / outwards);
        } else if distance < 0.0 {
            return None;
        }
    }
    let at = |part: f64| match part {
        0.0 => from,
        1.0 => to,
        part => (from.0 + part * dx, from.1 + part * dy),
    };
    (first <= last).then(|| (at(first), at(last)))
}

/// Joins segments in order to lines: a line continues if the next segment begins at its end.
pub(super) fn joined(segments: impl Iterator<Item = (Point, Point)>) -> Vec<Vec<Point>> {
    let mut lines: Vec<Vec<Point>> = Vec::new();
    for (from, to) in segments {
        match lines.last_mut() {
            Some(line) if line.last() == Some(&from) => line.push(to),
            _ => lines.push(vec![from, to]),
        }
    }
    lines
}

/// The parts of a line within a panel.
pub(super) fn line(points: &[Point], panel: [f64; 4]) -> Vec<Vec<Point>> {
    let segments = points.windows(2);
    joined(segments.filter_map(|ends| segment(ends[0], ends[1], panel)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PANEL: [f64; 4] = [0.0, 0.0, 10.0, 10.0];

    #[test]
    fn lines_end_where_the_panel_does() {
        let through = segment((-5.0, 5.0), (15.0, 5.0), PANEL);
        assert_eq!(through, Some(((0.0, 5.0), (10.0, 5.0))));
        assert_eq!(segment((-5.0, 1.0), (4.0, -20.0), PANEL), None);
        assert_eq!(segment((11.0, 0.0), (11.0, 9.0), PANEL), None);
        let inside = [(1.0, 1.0), (2.0, 2.0), (2.0, 30.0), (4.0, 30.0), (4.0, 3.0)];
        let parts = line(&inside, PANEL);
        let expected = vec![
            vec![(1.0, 1.0), (2.0, 2.0), (2.0, 10.0)],
            vec![(4.0, 10.0), (4.0, 3.0)],
        ];
        assert_eq!(parts, expected);
    }
}
