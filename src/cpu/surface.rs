//! From the visibility buffer to surface points: barycentric coordinates and how they change on the screen, by analysis,
//! interpolated normals and vertex colours, eight pixels of one instance at a time.

use super::lanes::{LANES, Lanes, Vec3x8, apply, blend, cross, minus, normalize, splat3};
use super::stroke::share_along;
use crate::limits::{CLUSTER_MAX_TRIANGLES, SHADOW_ROUNDING};
use crate::math::octahedral::OCTAHEDRAL_STEPS;
use crate::model::{ClusterAddress, ClusterGeometry, ColorFormat};
use crate::scene::placement::Eye;
use crate::views::{Hit, InstanceView, Screen, Stroke, Visible, decode};

/// A finished visibility buffer with all that is needed to read it.
#[derive(Clone, Copy)]
pub struct Pixels<'a> {
    /// Words, row by row from the top.
    pub words: &'a [u64],
    /// The frame's visible list.
    pub visible: &'a [Visible],
    /// The frame's instances.
    pub views: &'a [InstanceView],
    /// The view.
    pub screen: &'a Screen,
}

/// What a triangle has at its corners.
#[derive(Clone, Copy)]
struct Corners {
    /// Internal space.
    positions: [[f32; 3]; 3],
    /// As they are packed.
    normals: [u32; 3],
    /// Components of colours, unscaled.
    colors: [[f32; 3]; 3],
}

impl Corners {
    const NONE: Self = Self { positions: [[0.0; 3]; 3], normals: [0; 3], colors: [[0.0; 3]; 3] };

    #[inline(always)]
    fn of(view: &InstanceView, geometry: &ClusterGeometry<'_>, triangle: usize) -> Self {
        let mut out = Self::NONE;
        // Points are one vertex, and nobody asks where that lies.
        let point = view.stroke.is_some_and(|stroke| !stroke.line);
        let corners = geometry.triangles.get(triangle);
        for (i, corner) in corners.into_iter().enumerate().take(if point { 1 } else { 3 }) {
            let corner = usize::from(corner);
            out.positions[i] = geometry.positions.get(corner);
            out.normals[i] = geometry.normals[corner];
            if !geometry.colors.is_empty() {
                out.colors[i] = components(view.mesh.layout().colors, geometry.colors, corner);
            }
        }
        out
    }
}

/// Triangles that were unpacked last: pixels beside and below mostly show the same.
struct Unpacked {
    /// Which triangle is in each place: its visible cluster and its number, plus one.
    keys: [u64; Self::PLACES],
    corners: [Corners; Self::PLACES],
}

impl Unpacked {
    const PLACES: usize = CLUSTER_MAX_TRIANGLES;

    const NONE: Self = Self { keys: [0; Self::PLACES], corners: [Corners::NONE; Self::PLACES] };

    /// A triangle, unpacked by `make` where it is not there.
    #[inline(always)]
    fn get(&mut self, hit: Hit, make: impl FnOnce() -> Corners) -> &Corners {
        let key = (u64::from(hit.visible) << 32 | u64::from(hit.triangle)) + 1;
        // Each triangle of a cluster has a place of its own; clusters beside each other have other numbers.
        let place = (hit.triangle ^ hit.visible.wrapping_mul(0x9e37_79b1) >> 25) as usize % Self::PLACES;
        if self.keys[place] != key {
            (self.keys[place], self.corners[place]) = (key, make());
        }
        &self.corners[place]
    }
}

/// What eight covered pixels need from memory.
struct Gathered<'a> {
    count: usize,
    /// Index in `views`.
    instance: u32,
    view: &'a InstanceView,
    /// Numbers of the pixels.
    pixels: [u32; LANES],
    /// Their centres.
    point: [Lanes; 2],
    hits: [Hit; LANES],
    clusters: [ClusterAddress; LANES],
    positions: [[Lanes; 3]; 3],
    normals: [[u32; LANES]; 3],
    /// Components of the corners' colours, unscaled.
    colors: [Vec3x8; 3],
}

/// Up to eight surface points of one instance, with [`Detail`] or, as `()`, without.
pub struct Surfels<'a, D = ()> {
    /// How many lanes count.
    pub count: usize,
    /// Index of the instance in the frame's list.
    pub instance: u32,
    /// The instance.
    pub view: &'a InstanceView,
    /// Numbers of the pixels, row by row from the top.
    pub pixels: [u32; LANES],
    /// What each pixel shows.
    pub hits: [Hit; LANES],
    /// The cluster of each.
    pub clusters: [ClusterAddress; LANES],
    /// Pixel centres.
    pub point: [Lanes; 2],
    /// Distances along the view axis.
    pub distance: Lanes,
    /// Unit normals, camera space.
    pub normal: Vec3x8,
    /// Vertex colours, linear RGB, of meshes that have them.
    pub color: Option<Vec3x8>,
    /// How the triangle lies, where that was asked for.
    pub detail: D,
}

/// How triangles lie at surface points.
pub struct Detail {
    /// Barycentric coordinates.
    pub weights: Vec3x8,
    /// What they change by from a pixel to the next on the right, and to the one below.
    pub change: [Vec3x8; 2],
    /// Corners, internal space.
    pub corners: [Vec3x8; 3],
    /// Unit normals of the triangles, camera space.
    pub face: Vec3x8,
}

/// What surface points have besides: a type, so that points without are no larger for it.
pub trait Extra: Sized {
    /// Whether it is [`Detail`].
    const DETAIL: bool;
    /// What it is of what `make` makes.
    fn of(make: impl FnOnce() -> Detail) -> Self;
    /// The detail, where it is that.
    fn detail(&self) -> Option<&Detail>;
}

impl Extra for () {
    const DETAIL: bool = false;

    #[inline(always)]
    fn of(_: impl FnOnce() -> Detail) -> Self {}

    #[inline(always)]
    fn detail(&self) -> Option<&Detail> {
        None
    }
}

impl Extra for Detail {
    const DETAIL: bool = true;

    #[inline(always)]
    fn of(make: impl FnOnce() -> Detail) -> Self {
        make()
    }

    #[inline(always)]
    fn detail(&self) -> Option<&Detail> {
        Some(self)
    }
}

/// Walks the covered pixels of a range in order, up to eight of one instance at a time.
pub struct Walk<'a> {
    pixels: Pixels<'a>,
    next: usize,
    end: usize,
    /// Row of the next pixel, and where that begins.
    row: usize,
    row_start: usize,
    /// The visible cluster of the pixel before: its neighbours mostly show the same.
    last: u32,
    at: Visible,
    /// The visible cluster that was unpacked from last.
    opened: u32,
    geometry: ClusterGeometry<'a>,
    unpacked: Unpacked,
    gathered: Gathered<'a>,
}

impl<'a> Walk<'a> {
    /// Starts a walk; `None` where nothing can be covered.
    #[inline(always)]
    pub fn new(pixels: Pixels<'a>, range: std::ops::Range<usize>) -> Option<Self> {
        let at = *pixels.visible.first()?;
        let geometry = pixels.views[at.instance as usize].cluster(at.cluster);
        let gathered = Gathered::none(pixels, at);
        let [_, row] = pixels.screen.pixel_of(range.start as u32).map(|v| v as usize);
        let row_start = pixels.screen.pixel_address(0, row);
        let (next, end) = (range.start, range.end);
        let unpacked = Unpacked::NONE;
        Some(Self { pixels, next, end, row, row_start, last: 0, at, opened: 0, geometry, unpacked, gathered })
    }

    /// The next surface points.
    #[inline(always)]
    pub fn step<D: Extra>(&mut self) -> Option<Surfels<'a, D>> {
        let width = self.pixels.screen.width as usize;
        self.gathered.count = 0;
        while self.next < self.end {
            let words = self.pixels.words;
            let Some(hit) = decode(words[self.next]) else {
                self.next += 1;
                // Background comes in stretches.
                while self.next + 8 <= self.end && words[self.next..self.next + 8].iter().all(|w| *w == 0) {
                    self.next += 8;
                }
                continue;
            };
            if hit.visible != self.last {
                self.last = hit.visible;
                self.at = self.pixels.visible[hit.visible as usize];
            }
            if self.gathered.instance != self.at.instance {
                if self.gathered.count > 0 {
                    break;
                }
                self.gathered.instance = self.at.instance;
                self.gathered.view = &self.pixels.views[self.at.instance as usize];
            }
            while self.next >= self.row_start + width {
                self.row += 1;
                self.row_start += width;
            }
            let (view, geometry, opened, at) =
                (self.gathered.view, &mut self.geometry, &mut self.opened, self.at);
            let corners = self.unpacked.get(hit, || {
                if *opened != hit.visible {
                    (*opened, *geometry) = (hit.visible, view.cluster(at.cluster));
                }
                Corners::of(view, geometry, hit.triangle as usize)
            });
            let place = [self.next - self.row_start, self.row].map(|v| v as u32);
            self.gathered.push(self.next as u32, place, hit, at.cluster, corners);
            self.next += 1;
            if self.gathered.count == LANES {
                break;
            }
        }
        if self.gathered.count == 0 {
            return None;
        }
        Some(self.gathered.evaluate(self.pixels.screen))
    }
}

/// The surface point of one pixel, where it shows what `hit` says.
pub fn one<'a>(pixels: Pixels<'a>, pixel: usize, hit: Hit) -> Surfels<'a, Detail> {
    let at = pixels.visible[hit.visible as usize];
    let view = &pixels.views[at.instance as usize];
    let corners = Corners::of(view, &view.cluster(at.cluster), hit.triangle as usize);
    let mut gathered = Gathered::none(pixels, at);
    let place = pixels.screen.pixel_of(pixel as u32);
    gathered.push(pixel as u32, place, hit, at.cluster, &corners);
    gathered.evaluate(pixels.screen)
}

impl<'a> Gathered<'a> {
    #[inline(always)]
    fn none(pixels: Pixels<'a>, at: Visible) -> Self {
        let zero = Lanes::splat(0.0);
        let nothing = Hit { key: 1, visible: 0, triangle: 0 };
        Self {
            count: 0,
            instance: at.instance,
            view: &pixels.views[at.instance as usize],
            pixels: [0; LANES],
            point: [Lanes::splat(0.5); 2],
            hits: [nothing; LANES],
            clusters: [at.cluster; LANES],
            positions: [[zero; 3]; 3],
            normals: [[0; LANES]; 3],
            colors: [[zero; 3]; 3],
        }
    }

    #[inline(always)]
    fn push(&mut self, pixel: u32, place: [u32; 2], hit: Hit, cluster: ClusterAddress, corners: &Corners) {
        let lane = self.count;
        self.count += 1;
        (self.pixels[lane], self.hits[lane], self.clusters[lane]) = (pixel, hit, cluster);
        for k in 0..2 {
            self.point[k].0[lane] = place[k] as f32 + 0.5;
        }
        for i in 0..3 {
            for k in 0..3 {
                self.positions[i][k].0[lane] = corners.positions[i][k];
            }
            self.normals[i][lane] = corners.normals[i];
        }
        if self.view.mesh.layout().colors.is_some() {
            for i in 0..3 {
                for k in 0..3 {
                    self.colors[i][k].0[lane] = corners.colors[i][k];
                }
            }
        }
    }

    #[inline(always)]
    fn evaluate<D: Extra>(&self, screen: &Screen) -> Surfels<'a, D> {
        let view = self.view;
        let point = self.point;
        let mut distance = Lanes::splat(1.0);
        for lane in 0..LANES {
            distance.0[lane] = screen.distance(self.hits[lane].key);
        }
        if let Some(stroke) = &view.stroke {
            return self.evaluate_stroke(screen, stroke, point, distance);
        }
        let [a, b, c] = &self.positions;
        let coordinates = Barycentric::new(&view.screen, screen.orthographic, [a, b, c], &point);
        let weights = coordinates.weights();
        let face = || apply(&view.normal, &normalize(&cross(&minus(b, a), &minus(c, a))));
        let normal = if view.materials.smooth() {
            let [a, b, c] = &self.normals;
            let corners = [decode_normal(a), decode_normal(b), decode_normal(c)];
            if view.conformal {
                apply(&view.normal, &blend(&weights, &corners))
            } else {
                let [a, b, c] = &corners;
                let m = &view.normal;
                let turned = [normalize(&apply(m, a)), normalize(&apply(m, b)), normalize(&apply(m, c))];
                blend(&weights, &turned)
            }
        } else {
            face()
        };
        let detail = D::of(|| Detail {
            weights,
            change: coordinates.change(&view.screen, screen.orthographic, [a, b, c], &weights),
            corners: self.positions,
            face: normalize(&face()),
        });
        self.surfels(point, distance, normalize(&normal), self.color(&weights), detail)
    }

    #[inline(always)]
    fn surfels<D>(
        &self,
        point: [Lanes; 2],
        distance: Lanes,
        normal: Vec3x8,
        color: Option<Vec3x8>,
        detail: D,
    ) -> Surfels<'a, D> {
        Surfels {
            count: self.count,
            instance: self.instance,
            view: self.view,
            pixels: self.pixels,
            hits: self.hits,
            clusters: self.clusters,
            point,
            distance,
            normal,
            color,
            detail,
        }
    }

    /// Vertex colours.
    #[inline(always)]
    fn color(&self, weights: &Vec3x8) -> Option<Vec3x8> {
        let format = self.view.mesh.layout().colors;
        let step = 1.0 / format.one();
        format.is_some().then(|| blend(weights, &self.colors.map(|corner| corner.map(|x| x * step))))
    }

    /// Points and lines face the eye.
    #[inline(always)]
    fn evaluate_stroke<D: Extra>(
        &self,
        screen: &Screen,
        stroke: &Stroke,
        point: [Lanes; 2],
        distance: Lanes,
    ) -> Surfels<'a, D> {
        let (view, zero) = (self.view, Lanes::splat(0.0));
        let mut weights = [1.0, 0.0, 0.0].map(Lanes::splat);
        if stroke.line {
            for lane in 0..self.count {
                let ends = [0, 1].map(|i: usize| self.positions[i].map(|axis| axis.0[lane]));
                let at = point.map(|axis| axis.0[lane]);
                let t = share_along(&view.screen, ends, at, distance.0[lane], screen.orthographic);
                (weights[0].0[lane], weights[1].0[lane]) = (1.0 - t, t);
            }
        }
        let facing = splat3([0.0, 0.0, 1.0]);
        let color = if stroke.line { self.color(&weights) } else { self.first_color() };
        let change = [[zero; 3]; 2];
        let detail = D::of(|| Detail { weights, change, corners: self.positions, face: facing });
        self.surfels(point, distance, facing, color, detail)
    }

    /// The colour of the first corner.
    #[inline(always)]
    fn first_color(&self) -> Option<Vec3x8> {
        let format = self.view.mesh.layout().colors;
        let step = 1.0 / format.one();
        format.is_some().then(|| self.colors[0].map(|x| x * step))
    }
}

/// From pixels and distances to camera space.
#[inline(always)]
pub fn position(eye: &Eye, orthographic: bool, point: &[Lanes; 2], distance: Lanes) -> Vec3x8 {
    let scale = if orthographic { Lanes::splat(1.0) } else { distance };
    let up = -(point[1] - eye.center[1]) * eye.inverse_focal[1];
    let right = (point[0] - eye.center[0] - up * eye.skew) * eye.inverse_focal[0];
    [right * scale, up * scale, -distance]
}

/// Rows of a map to homogeneous screen space.
type Rows = [[f32; 4]; 3];

/// Perspective-correct barycentric coordinates of points of the screen on triangles, also where these reach
/// behind the eye: the solution λ of Σ λᵢ (xᵢ, yᵢ) = p Σ λᵢ dᵢ in homogeneous screen coordinates.
///
/// After Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", Graphics Hardware 1997.
struct Barycentric {
    /// Coordinates of the corners, relative to the point.
    x: Vec3x8,
    y: Vec3x8,
    /// λ, but for their sum.
    cross: Vec3x8,
    /// One over that.
    inverse: Lanes,
}

impl Barycentric {
    #[inline(always)]
    fn new(rows: &Rows, orthographic: bool, corners: [&Vec3x8; 3], point: &[Lanes; 2]) -> Self {
        let x = along(rows, orthographic, 0, corners, point[0]);
        let y = along(rows, orthographic, 1, corners, point[1]);
        let cross = cross(&x, &y);
        let inverse = Lanes::splat(1.0) / (cross[0] + cross[1] + cross[2]);
        Self { x, y, cross, inverse }
    }

    /// Those of the points. Points just outside (by snapping) are moved to the nearest edge.
    #[inline(always)]
    fn weights(&self) -> Vec3x8 {
        let Self { cross, inverse, .. } = self;
        // A degenerate triangle gives NaN here, which `max` turns into 0.
        let w0 = (cross[0] * *inverse).max(0.0).min(1.0);
        let w1 = (cross[1] * *inverse).max(0.0).min(1.0);
        let w2 = (cross[2] * *inverse).max(0.0).min(1.0);
        let sum = w0 + w1 + w2;
        let (empty, third) = (sum - f32::MIN_POSITIVE, Lanes::splat(1.0 / 3.0));
        let inverse = Lanes::splat(1.0) / sum;
        [
            empty.where_negative(third, w0 * inverse),
            empty.where_negative(third, w1 * inverse),
            empty.where_negative(third, w2 * inverse),
        ]
    }

    /// What they change by from a pixel to the next on the right, and to the one below: derivatives of a quotient of
    /// sums that are linear in the point.
    #[inline(always)]
    fn change(
        &self,
        rows: &Rows,
        orthographic: bool,
        corners: [&Vec3x8; 3],
        weights: &Vec3x8,
    ) -> [Vec3x8; 2] {
        // What the coordinates of the corners lose by a pixel.
        let mut loss = [Lanes::splat(1.0); 3];
        if !orthographic {
            for i in 0..3 {
                loss[i] = row(&rows[2], corners[i]);
            }
        }
        let of = |d: Vec3x8| {
            let sum = d[0] + d[1] + d[2];
            [
                (d[0] - weights[0] * sum) * self.inverse,
                (d[1] - weights[1] * sum) * self.inverse,
                (d[2] - weights[2] * sum) * self.inverse,
            ]
        };
        [of(cross(&self.y, &loss)), of(cross(&loss, &self.x))]
    }
}

/// Homogeneous coordinate `k` of three corners, relative to a point of the screen.
#[inline(always)]
fn along(rows: &Rows, orthographic: bool, k: usize, corners: [&Vec3x8; 3], point: Lanes) -> Vec3x8 {
    let mut out = [point; 3];
    for i in 0..3 {
        let at = row(&rows[k], corners[i]);
        out[i] = if orthographic { at - point } else { at - point * row(&rows[2], corners[i]) };
    }
    out
}

#[inline(always)]
fn row(m: &[f32; 4], p: &Vec3x8) -> Lanes {
    p[0] * m[0] + p[1] * m[1] + p[2] * m[2] + m[3]
}

/// [`crate::math::octahedral::decode`], eight at a time.
#[inline(always)]
fn decode_normal(packed: &[u32; LANES]) -> Vec3x8 {
    let (mut x, mut y) = (Lanes::splat(0.0), Lanes::splat(0.0));
    for lane in 0..LANES {
        x.0[lane] = ((packed[lane] << 16) as i32 >> 16) as f32;
        y.0[lane] = (packed[lane] as i32 >> 16) as f32;
    }
    let (x, y) = (x / OCTAHEDRAL_STEPS, y / OCTAHEDRAL_STEPS);
    let z = -(x.abs() + y.abs() - 1.0);
    let t = (-z).max(0.0);
    let v = [x.where_negative(x + t, x - t), y.where_negative(y + t, y - t), z];
    let inverse = Lanes::splat(1.0) / super::lanes::dot(&v, &v).sqrt();
    [v[0] * inverse, v[1] * inverse, v[2] * inverse]
}

/// Red, green and blue of a vertex, as whole numbers where the format has such.
#[inline(always)]
fn components(format: ColorFormat, colors: &[u32], vertex: usize) -> [f32; 3] {
    let at = format.words() * vertex;
    let whole = |x: u32| x as i32 as f32;
    match format {
        ColorFormat::None => [0.0; 3],
        ColorFormat::Unorm8 => [0, 8, 16].map(|shift| whole(colors[at] >> shift & 0xff)),
        ColorFormat::Unorm16 => {
            let [rg, b] = [colors[at], colors[at + 1]];
            [rg & 0xffff, rg >> 16, b & 0xffff].map(whole)
        }
        ColorFormat::Float32 => [0, 1, 2].map(|k| f32::from_bits(colors[at + k])),
    }
}

/// By how much what is drawn of a cluster may be off its source, world units: its own error, and rounding.
pub fn receiver_error(view: &InstanceView, cluster: ClusterAddress) -> f32 {
    let (_, error) = view.mesh.own_error(view.pages.record(cluster));
    (error.max(0.0) + view.lod.rounding + SHADOW_ROUNDING) * view.lod.scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::octahedral;

    #[test]
    fn changes_are_those_of_finite_differences() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        for case in 0..400 {
            let orthographic = case % 4 == 3;
            let far = if orthographic { [0.0, 0.0, 0.0, 1.0] } else { [0.1, -0.2, 1.0, 2.5] };
            let rows = [[300.0, 20.0, 80.0, 400.0], [-30.0, 250.0, 90.0, 300.0], far];
            let corners: [[f64; 3]; 3] =
                std::array::from_fn(|_| std::array::from_fn(|_| 2.0 * random() - 1.0));
            let inside = [0.2 + random(), 0.2 + random(), 0.2 + random()];
            let homogeneous =
                corners.map(|p| rows.map(|m: [f64; 4]| m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]));
            let sum = |k: usize| (0..3).map(|i| inside[i] * homogeneous[i][k]).sum::<f64>();
            let depth = if orthographic { inside.iter().sum() } else { sum(2) };
            let point = [sum(0) / depth, sum(1) / depth];
            let exact = |[px, py]: [f64; 2]| {
                let d = homogeneous.map(|h| if orthographic { 1.0 } else { h[2] });
                let x: [f64; 3] = std::array::from_fn(|i| homogeneous[i][0] - px * d[i]);
                let y: [f64; 3] = std::array::from_fn(|i| homogeneous[i][1] - py * d[i]);
                let w = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
                w.map(|v| v / w.iter().sum::<f64>())
            };
            // Triangles seen edge on are no ground to stand on.
            let area = |a: [f64; 3], b: [f64; 3], c: [f64; 3]| {
                let at = |h: [f64; 3], k: usize| h[k] / if orthographic { 1.0 } else { h[2] };
                (at(b, 0) - at(a, 0)) * (at(c, 1) - at(a, 1)) - (at(c, 0) - at(a, 0)) * (at(b, 1) - at(a, 1))
            };
            if area(homogeneous[0], homogeneous[1], homogeneous[2]).abs() < 500.0 {
                continue;
            }
            let single = rows.map(|row| row.map(|v| v as f32));
            let lanes = corners.map(|p| p.map(|v| Lanes::splat(v as f32)));
            let at = point.map(|v| Lanes::splat(v as f32));
            let [a, b, c] = &lanes;
            let coordinates = Barycentric::new(&single, orthographic, [a, b, c], &at);
            let change = coordinates.change(&single, orthographic, [a, b, c], &coordinates.weights());
            for axis in 0..2 {
                let mut moved = [point; 2];
                (moved[0][axis], moved[1][axis]) = (point[axis] + 0.01, point[axis] - 0.01);
                let (ahead, behind) = (exact(moved[0]), exact(moved[1]));
                let expected: [f64; 3] = std::array::from_fn(|i| (ahead[i] - behind[i]) / 0.02);
                let scale = expected.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                for i in 0..3 {
                    let got = f64::from(change[axis][i].0[0]);
                    assert!(
                        (got - expected[i]).abs() <= 1e-3 * scale,
                        "case {case}: {got} for {}",
                        expected[i]
                    );
                }
            }
        }
    }

    #[test]
    fn eight_normals_decode_as_one() {
        for i in 0..3000u32 {
            let word = i.wrapping_mul(2_654_435_761);
            // The encoder never makes −32768.
            if word as u16 == 0x8000 || word >> 16 == 0x8000 {
                continue;
            }
            let expected = octahedral::decode(word);
            let got = decode_normal(&[word; LANES]);
            for k in 0..3 {
                assert!((got[k].0[3] - expected[k]).abs() < 1e-6, "{word:x}");
            }
        }
    }
}
