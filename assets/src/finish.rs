//! Surface finishes and the palette of a kitchen.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use crate::texture::Texture;

/// A surface finish: one material of the written meshes.
#[derive(Debug, Clone, PartialEq)]
pub struct Finish {
    /// Name, unique among finishes that look different.
    pub name: String,
    /// Colour, sRGB in 0..1; white where a texture gives it.
    pub color: [f64; 3],
    /// Texture, if any.
    pub texture: Option<Texture>,
    /// Edge of one texture tile on the surface, metres.
    pub tile_m: f64,
    /// 0 dielectric .. 1 metal.
    pub metallic: f64,
    /// 0 mirror .. 1 matt.
    pub roughness: f64,
}

impl Finish {
    /// A plain colour, sRGB in 0..1.
    pub fn plain(name: &str, color: [f64; 3], metallic: f64, roughness: f64) -> Self {
        Self { name: name.into(), color, texture: None, tile_m: 1.0, metallic, roughness }
    }

    /// A textured finish whose texture repeats every `tile_m` metres.
    pub fn textured(name: &str, texture: Texture, tile_m: f64, metallic: f64) -> Self {
        let roughness = if metallic > 0.5 { 0.35 } else { 0.7 };
        let texture = Some(texture);
        Self { name: name.into(), color: [1.0; 3], texture, tile_m, metallic, roughness }
    }
}

/// The finishes of one kitchen.
#[derive(Debug, Clone, PartialEq)]
pub struct Palette {
    /// Fronts of cabinets.
    pub front: Finish,
    /// Carcasses and drawer boxes.
    pub carcass: Finish,
    /// Worktops and tables.
    pub worktop: Finish,
    /// Handles.
    pub handle: Finish,
    /// Housings of appliances.
    pub appliance: Finish,
    /// Dark glass and control panels.
    pub glass: Finish,
    /// Cavities, plinths and rubber.
    pub dark: Finish,
    /// Floors.
    pub floor: Finish,
    /// Walls.
    pub wall: Finish,
    /// Crockery and other small things.
    pub accents: [Finish; 3],
}

impl Palette {
    /// A palette drawn from tones that go together.
    pub fn sample(rng: &mut ChaCha8Rng) -> Self {
        const FRONTS: [[f64; 3]; 5] = [
            [0.90, 0.89, 0.85],
            [0.36, 0.45, 0.42],
            [0.30, 0.37, 0.46],
            [0.74, 0.71, 0.65],
            [0.62, 0.34, 0.25],
        ];
        const WOODS: [[f64; 3]; 3] = [[0.72, 0.53, 0.35], [0.52, 0.35, 0.22], [0.82, 0.68, 0.50]];
        const FLOORS: [[f64; 3]; 3] = [[0.72, 0.69, 0.64], [0.55, 0.52, 0.50], [0.80, 0.78, 0.74]];
        const WALLS: [[f64; 3]; 3] = [[0.93, 0.92, 0.88], [0.86, 0.89, 0.88], [0.92, 0.88, 0.80]];
        let mut choose = |tones: &[[f64; 3]]| tones[rng.random_range(0..tones.len())];
        let (front, wood, floor, wall) =
            (choose(&FRONTS), choose(&WOODS), choose(&FLOORS), choose(&WALLS));
        let steel = Texture::Brushed { tone: [0.66, 0.67, 0.69], seed: rng.random() };
        let grain = Texture::Wood { tone: wood, seed: rng.random() };
        let tiles = Texture::Tiles { tone: floor, seed: rng.random() };
        Self {
            front: Finish::plain("front", front, 0.0, 0.5),
            carcass: Finish::plain("carcass", [0.88, 0.87, 0.84], 0.0, 0.7),
            worktop: Finish::textured("worktop", grain, 0.6, 0.0),
            handle: Finish::plain("handle", [0.56, 0.57, 0.58], 1.0, 0.3),
            appliance: Finish::textured("appliance", steel, 0.25, 0.8),
            glass: Finish::plain("glass", [0.06, 0.07, 0.08], 0.0, 0.1),
            dark: Finish::plain("dark", [0.12, 0.12, 0.12], 0.0, 0.9),
            floor: Finish::textured("floor", tiles, 0.8, 0.0),
            wall: Finish::plain("wall", wall, 0.0, 0.9),
            accents: [
                Finish::plain("accent_red", [0.72, 0.24, 0.18], 0.0, 0.4),
                Finish::plain("accent_blue", [0.20, 0.35, 0.55], 0.0, 0.4),
                Finish::plain("accent_white", [0.94, 0.93, 0.90], 0.0, 0.3),
            ],
        }
    }
}
