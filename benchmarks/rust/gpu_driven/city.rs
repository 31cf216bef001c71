//! A city at street level, where most of what lies in the view is hidden, and four motions through it.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use nanite_rs::build::{Silent, build};
use nanite_rs::config::{BuildOptions, ErrorMeasure};
use nanite_rs::mesh::{Positions, SourceMesh};
use nanite_rs::model::Dag;
use nanite_rs::scene::{Camera, InstanceHandle, Material, Projection, Scene};

use crate::shapes::{self, Mesh};

pub type Pose = [[f64; 4]; 4];

pub const CAMERA: Camera =
    Camera { projection: Projection::Perspective { yfov: 0.9, aspect: None }, znear: 0.05, zfar: None };

/// Blocks to a side, each with a building; from the middle of one to the middle of the next.
const BLOCKS: i32 = 20;
const PITCH: f64 = 3.0;
/// Half the width of a building: streets are 1.2 wide.
const HALF: f64 = 0.9;
/// Of the eye above the street.
const HEIGHT: f64 = 0.7;
/// Vehicles, which move in one of the motions.
const VEHICLES: usize = 60;

/// How a frame differs from the one before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// Not at all.
    Static,
    /// The camera turns by 4 degrees, on a crossing.
    Turning,
    /// The camera goes on by a third of a block and turns by 5 degrees.
    Fast,
    /// The camera stands; vehicles go on by half a unit, more than their length in three frames.
    Vehicles,
}

pub const MOTIONS: [Motion; 4] = [Motion::Static, Motion::Turning, Motion::Fast, Motion::Vehicles];

impl Motion {
    pub fn name(self) -> &'static str {
        match self {
            Self::Static => "static",
            Self::Turning => "turning",
            Self::Fast => "fast",
            Self::Vehicles => "vehicles",
        }
    }

    /// Camera to world.
    pub fn camera(self, frame: usize) -> Pose {
        let step = frame as f64;
        // Degrees from +x to +z.
        let (x, yaw) = match self {
            Self::Static | Self::Vehicles => (-13.0, 12.0),
            Self::Turning => (0.5 * PITCH, 4.0 * step),
            Self::Fast => (-19.0 + step, 20.0 + 5.0 * step),
        };
        let eye = DVec3::new(x, HEIGHT, 0.5 * PITCH);
        let turn = DAffine3::from_rotation_y(-FRAC_PI_2 - f64::to_radians(yaw));
        rows(&(DAffine3::from_translation(eye) * turn))
    }
}

/// The scene with what moves in it.
pub struct City {
    pub scene: Scene,
    vehicles: Vec<InstanceHandle>,
}

impl City {
    /// Meshes have some `detail`² triangles times a small number.
    pub fn new(detail: usize) -> Self {
        let meshes = [relief(shapes::cube(detail)), shapes::bumpy_sphere(detail), ground(2 * detail)];
        let [house, ball, ground] = meshes.map(|mesh| dag(&mesh));
        let mut scene = Scene::new();
        let mut add = |mesh: &Arc<Dag>, pose: DAffine3| {
            scene.add(Arc::clone(mesh), &rows(&pose), Material::default()).expect("an instance")
        };
        let side = PITCH * f64::from(BLOCKS + 2);
        // From the unit square in x and y, with heights along z.
        let lying = DMat3::from_cols(DVec3::X * side, DVec3::NEG_Z * side, DVec3::Y);
        add(&ground, DAffine3 { matrix3: lying, translation: DVec3::new(-0.5 * side, 0.0, 0.5 * side) });
        for i in -BLOCKS / 2..BLOCKS / 2 {
            for j in -BLOCKS / 2..BLOCKS / 2 {
                let at = DVec3::new(PITCH * f64::from(i), 0.0, PITCH * f64::from(j));
                let height = 1.0 + 0.25 * f64::from((7 * i + 11 * j).rem_euclid(9));
                let house_pose = DAffine3::from_translation(at + DVec3::Y * height);
                add(&house, house_pose * DAffine3::from_scale(DVec3::new(HALF, height, HALF)));
                // Small things at the kerbs of two streets.
                for (x, z) in [(0.6, 1.1), (-0.5, 1.15), (1.1, 0.4), (1.15, -0.7)] {
                    let place = DAffine3::from_translation(at + DVec3::new(x, 0.12, z));
                    add(&ball, place * DAffine3::from_scale(DVec3::splat(0.12)));
                }
            }
        }
        let vehicles = (0..VEHICLES).map(|k| add(&house, vehicle(k, 0))).collect();
        Self { scene, vehicles }
    }

    /// Puts everything where it is in a frame.
    pub fn set(&mut self, motion: Motion, frame: usize) {
        let step = if motion == Motion::Vehicles { frame } else { 0 };
        for (k, &handle) in self.vehicles.iter().enumerate() {
            self.scene.set_pose(handle, &rows(&vehicle(k, step))).expect("a pose");
        }
    }
}

/// One of the vehicles, along its street: of every four, three pass the standing camera's street.
fn vehicle(number: usize, step: usize) -> DAffine3 {
    let length = PITCH * f64::from(BLOCKS);
    let lane = if number.is_multiple_of(4) { number as i32 / 4 % 9 - 4 } else { 0 };
    let forward = if number.is_multiple_of(2) { 1.0 } else { -1.0 };
    let along = (1.618 * number as f64 + 0.5 * forward * step as f64).rem_euclid(length) - 0.5 * length;
    let at = DVec3::new(along, 0.3, PITCH * (f64::from(lane) + 0.5) + 0.25 * forward);
    DAffine3::from_translation(at) * DAffine3::from_scale(DVec3::new(0.45, 0.28, 0.18))
}

fn rows(pose: &DAffine3) -> Pose {
    let (m, t) = (pose.matrix3, pose.translation);
    let row = |k: usize| [m.x_axis[k], m.y_axis[k], m.z_axis[k], t[k]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

/// Facades with something on them at every scale.
fn relief((positions, faces): Mesh) -> Mesh {
    let moved = positions.iter().map(|p| {
        let [x, y, z] = p.map(f64::from);
        let wide = (11.0 * x).sin() * (13.0 * y).sin() + (12.0 * z).sin() * (10.0 * y).cos();
        let fine = (61.0 * x).sin() * (67.0 * y).sin() + (71.0 * z).sin() * (53.0 * x).cos();
        [x, y, z].map(|v| (v * (1.0 + 0.012 * wide + 0.003 * fine)) as f32)
    });
    (moved.collect(), faces)
}

fn ground(n: usize) -> Mesh {
    shapes::grid(n, |x, y| 0.03 * (90.0 * x).sin() * (80.0 * y).cos())
}

fn dag((positions, faces): &Mesh) -> Arc<Dag> {
    let options = BuildOptions { error: ErrorMeasure::Quadric, ..BuildOptions::default() };
    let source = SourceMesh::new(Positions::F32(positions), faces);
    Arc::new(build(&source, &options, &Silent).expect("a mesh builds"))
}
