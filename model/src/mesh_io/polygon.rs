//! Triangulation of planar polygons, concave ones included.

/// Corner indices of triangles that cover the polygon, with its winding. Ear clipping in the plane
/// that the Newell normal points away from most; polygons of under three corners give nothing, and
/// what is left of a self-intersecting outline is fanned.
pub fn triangulate(outline: &[[f32; 3]]) -> Vec<[usize; 3]> {
    match outline.len() {
        0..=2 => return Vec::new(),
        3 => return vec![[0, 1, 2]],
        _ => {}
    }
    let flat = project(outline);
    let mut left: Vec<usize> = (0..outline.len()).collect();
    let mut triangles = Vec::with_capacity(outline.len() - 2);
    while left.len() > 3 {
        let Some(ear) = (0..left.len()).find(|&at| is_ear(&flat, &left, at)) else { break };
        let [before, after] = neighbours(left.len(), ear);
        triangles.push([left[before], left[ear], left[after]]);
        left.remove(ear);
    }
    triangles.extend((1..left.len() - 1).map(|i| [left[0], left[i], left[i + 1]]));
    triangles
}

fn neighbours(count: usize, at: usize) -> [usize; 2] {
    [(at + count - 1) % count, (at + 1) % count]
}

/// The outline in two dimensions, counter-clockwise: the coordinate along which the Newell normal is
/// largest is dropped.
fn project(outline: &[[f32; 3]]) -> Vec<[f64; 2]> {
    let normal = newell_normal(outline);
    let axis = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).unwrap_or(2);
    let (mut u, mut v) = ((axis + 1) % 3, (axis + 2) % 3);
    if normal[axis] < 0.0 {
        (u, v) = (v, u);
    }
    outline.iter().map(|p| [f64::from(p[u]), f64::from(p[v])]).collect()
}

fn newell_normal(outline: &[[f32; 3]]) -> [f64; 3] {
    let mut normal = [0.0; 3];
    for (index, a) in outline.iter().enumerate() {
        let a = a.map(f64::from);
        let b = outline[(index + 1) % outline.len()].map(f64::from);
        for (k, sum) in normal.iter_mut().enumerate() {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            *sum += (a[i] - b[i]) * (a[j] + b[j]);
        }
    }
    normal
}

/// Twice the signed area of a triangle.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn is_ear(flat: &[[f64; 2]], left: &[usize], at: usize) -> bool {
    let [before, after] = neighbours(left.len(), at);
    let [a, b, c] = [flat[left[before]], flat[left[at]], flat[left[after]]];
    if cross(a, b, c) <= 0.0 {
        return false;
    }
    let holds = |p| cross(a, b, p) >= 0.0 && cross(b, c, p) >= 0.0 && cross(c, a, p) >= 0.0;
    let is_corner = |p: [f64; 2]| p == a || p == b || p == c;
    !left.iter().map(|&i| flat[i]).any(|p| !is_corner(p) && holds(p))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(outline: &[[f32; 3]]) -> f64 {
        let flat = project(outline);
        triangulate(outline).iter().map(|t| cross(flat[t[0]], flat[t[1]], flat[t[2]]) / 2.0).sum()
    }

    #[test]
    fn concave_polygons_keep_their_area() {
        let ell = [[0.0f64, 0.], [2., 0.], [2., 1.], [1., 1.], [1., 2.], [0., 2.]];
        let outline = ell.map(|[x, y]| [x as f32, y as f32, 0.0]);
        assert_eq!(triangulate(&outline).len(), 4);
        assert!((area(&outline) - 3.0).abs() < 1e-9);
        let fan: f64 =
            (1..5).map(|i| cross(ell[1], ell[(i + 1) % 6], ell[(i + 2) % 6]).abs() / 2.0).sum();
        assert!((fan - 3.0).abs() > 0.1, "a fan would not have been right here");
    }

    #[test]
    fn winding_is_kept_in_every_plane() {
        for axis in 0..3 {
            let mut square = [[0.0f32; 3]; 4];
            for (corner, (u, v)) in square.iter_mut().zip([(0., 0.), (1., 0.), (1., 1.), (0., 1.)])
            {
                corner[axis] = u;
                corner[(axis + 1) % 3] = v;
            }
            let normal = newell_normal(&square);
            for [a, b, c] in triangulate(&square) {
                let part = newell_normal(&[square[a], square[b], square[c]]);
                assert!((0..3).map(|k| normal[k] * part[k]).sum::<f64>() > 0.0);
            }
        }
    }

    #[test]
    fn degenerate_outlines_do_not_panic() {
        assert!(triangulate(&[[0.0; 3]; 2]).is_empty());
        assert_eq!(triangulate(&[[0.0; 3]; 5]).len(), 3);
    }
}
