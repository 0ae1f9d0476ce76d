//! Drawing of triangles: an orthographic view with a depth buffer.

use glam::DVec3;

use crate::mesh::Mesh;

/// Pixels per side of a picture as drawn. It is shown at half that size, so that edges are smooth.
pub const SIZE: usize = 720;

/// Share of the picture that the object fills.
const FILL: f64 = 0.94;

/// Direction from the object to the eye: from the front, a little from the right and above. Objects
/// have y up, as from scanners and in glTF.
const EYE: DVec3 = DVec3::new(0.35, 0.3, 1.0);

/// The projection of the object. Pictures that are compared share one.
#[derive(Debug, Clone, Copy)]
pub struct View {
    centre: DVec3,
    scale: f64,
    right: DVec3,
    up: DVec3,
    eye: DVec3,
}

impl View {
    /// A view with the whole mesh in the picture.
    #[must_use]
    pub fn of(mesh: &Mesh) -> Self {
        let eye = EYE.normalize();
        let right = DVec3::Y.cross(eye).normalize();
        let up = eye.cross(right);
        let used = || mesh.triangles().iter().flatten().map(|&v| mesh.positions()[v as usize]);
        let span = |axis: DVec3| {
            let start = (f64::INFINITY, f64::NEG_INFINITY);
            used().map(|p| p.dot(axis)).fold(start, |(l, h), x| (l.min(x), h.max(x)))
        };
        let [x, y, z] = [right, up, eye].map(span);
        let middle = |(low, high): (f64, f64)| f64::midpoint(low, high);
        let centre = right * middle(x) + up * middle(y) + eye * middle(z);
        let widest = (x.1 - x.0).max(y.1 - y.0).max(f64::MIN_POSITIVE);
        Self { centre, scale: FILL * SIZE as f64 / widest, right, up, eye }
    }

    /// Pixel coordinates and height towards the eye.
    fn place(&self, p: DVec3) -> DVec3 {
        let (d, half) = (p - self.centre, SIZE as f64 / 2.0);
        DVec3::new(
            half + self.scale * d.dot(self.right),
            half - self.scale * d.dot(self.up),
            d.dot(self.eye),
        )
    }
}

/// Draws the mesh with the colour of each vertex, between 0 and 1, shaded by its normal. RGB bytes,
/// [`SIZE`] / 2 pixels a side.
#[must_use]
pub fn draw(mesh: &Mesh, view: &View, colours: &[DVec3]) -> Vec<u8> {
    let normals = normals(mesh);
    let shaded: Vec<DVec3> = colours
        .iter()
        .zip(&normals)
        .map(|(&colour, &normal)| colour * light(normal, view))
        .collect();
    let placed: Vec<DVec3> = mesh.positions().iter().map(|&p| view.place(p)).collect();
    let mut canvas = Canvas::new();
    for triangle in mesh.triangles() {
        let corners = triangle.map(|v| placed[v as usize]);
        canvas.triangle(corners, triangle.map(|v| shaded[v as usize]));
    }
    canvas.halved()
}

/// Per vertex, the sum of the area vectors around it, normalised.
fn normals(mesh: &Mesh) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; mesh.positions().len()];
    for triangle in mesh.triangles() {
        let [a, b, c] = triangle.map(|v| mesh.positions()[v as usize]);
        let normal = crate::mesh::surface::doubled_area(a, b, c);
        for &v in triangle {
            normals[v as usize] += normal;
        }
    }
    normals.into_iter().map(DVec3::normalize_or_zero).collect()
}

/// Light from above and left of the eye, on both sides of the surface, plus ambient light.
fn light(normal: DVec3, view: &View) -> f64 {
    let lamp = (view.eye + 0.5 * view.up - 0.5 * view.right).normalize();
    let facing = if normal.dot(view.eye) < 0.0 { -normal } else { normal };
    0.25 + 0.75 * facing.dot(lamp).max(0.0)
}

struct Canvas {
    depth: Vec<f64>,
    pixels: Vec<DVec3>,
}

impl Canvas {
    fn new() -> Self {
        Self { depth: vec![f64::NEG_INFINITY; SIZE * SIZE], pixels: vec![DVec3::ONE; SIZE * SIZE] }
    }

    /// Fills the pixels whose centres lie in the triangle.
    fn triangle(&mut self, corners: [DVec3; 3], colours: [DVec3; 3]) {
        let [a, b, c] = corners.map(DVec3::truncate);
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let low = a.min(b).min(c);
        let high = a.max(b).max(c);
        for y in pixels(low.y, high.y) {
            for x in pixels(low.x, high.x) {
                let p = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let (u, v) = ((c - b).perp_dot(p - b) / area, (a - c).perp_dot(p - c) / area);
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let depth = u * corners[0].z + v * corners[1].z + w * corners[2].z;
                let at = y * SIZE + x;
                if depth > self.depth[at] {
                    self.depth[at] = depth;
                    self.pixels[at] = u * colours[0] + v * colours[1] + w * colours[2];
                }
            }
        }
    }

    /// Means of two by two pixels, as bytes.
    fn halved(&self) -> Vec<u8> {
        let half = SIZE / 2;
        let mut bytes = Vec::with_capacity(3 * half * half);
        for y in 0..half {
            for x in 0..half {
                let at = 2 * y * SIZE + 2 * x;
                let four = [at, at + 1, at + SIZE, at + SIZE + 1];
                let mean = four.iter().map(|&at| self.pixels[at]).sum::<DVec3>() / 4.0;
                bytes.extend(mean.to_array().map(byte));
            }
        }
        bytes
    }
}

/// Pixels whose centres lie between two coordinates, within the picture.
fn pixels(low: f64, high: f64) -> std::ops::Range<usize> {
    let last = SIZE as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to SIZE")]
    let [from, to] =
        [(low - 0.5).ceil(), (high - 0.5).floor() + 1.0].map(|x| x.clamp(0.0, last) as usize);
    from..to.max(from)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 255")]
fn byte(share: f64) -> u8 {
    (255.0 * share.clamp(0.0, 1.0)).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles that face the eye, the red one in front of the left half of the green one.
    #[test]
    fn what_is_in_front_hides_what_is_behind() {
        let (eye, right, up) = {
            let flat = Mesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap();
            let view = View::of(&flat);
            (view.eye, view.right, view.up)
        };
        let sheet = |from: f64, to: f64, z: f64| {
            [(from, -1.0), (to, -1.0), (to, 1.0), (from, 1.0)]
                .map(|(x, y)| right * x + up * y + eye * z)
        };
        let positions = [sheet(-1.0, 1.0, 0.0), sheet(-1.0, 0.0, 1.0)].concat();
        let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let mesh = Mesh::new(positions, triangles).unwrap();
        let (red, green) = (DVec3::X, DVec3::Y);
        let colours = [[green; 4], [red; 4]].concat();
        let picture = draw(&mesh, &View::of(&mesh), &colours);
        let half = SIZE / 2;
        let pixel = |x: usize, y: usize| {
            let at = 3 * (y * half + x);
            (picture[at] > 100, picture[at + 1] > 100)
        };
        assert_eq!(pixel(half / 4, half / 2), (true, false));
        assert_eq!(pixel(3 * half / 4, half / 2), (false, true));
        assert_eq!(picture[..3], [255, 255, 255]);
    }
}
