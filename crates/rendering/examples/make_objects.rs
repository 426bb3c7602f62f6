//! Writes `config/objects/*` from numbers: `cargo run -p tdv-rendering --example make_objects`.
//! A test compares the committed files with what this makes, byte by byte.

mod task_objects;

use std::f64::consts::TAU;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use tdv_geometry::Symmetry;
use tdv_rendering::mesh::primitives::{MugSize, disc, lathe, mug, rounded_cuboid};
use tdv_rendering::{CollisionPart, Mesh, ObjectFile, PartShape};

const BLUE: [u8; 3] = [38, 84, 168];
const CREAM: [u8; 3] = [228, 222, 208];
const CORK: [u8; 3] = [158, 72, 48];
const YELLOW: [u8; 3] = [232, 182, 26];
const CAP: [u8; 3] = [226, 200, 120];
const LABEL: [u8; 3] = [168, 44, 36];
const GREEN: [u8; 3] = [62, 128, 92];
const WOOD: [u8; 3] = [206, 168, 112];

/// What the files are made of.
struct Made {
    comment: &'static str,
    file: ObjectFile,
    mesh: Mesh,
}

fn part(shape: PartShape, xyz: [f64; 3], rpy: [f64; 3]) -> CollisionPart {
    CollisionPart { shape, xyz, rpy }
}

fn upright(radius: f64, z: [f64; 2]) -> CollisionPart {
    let shape = PartShape::Cylinder { radius, height: z[1] - z[0] };
    part(shape, [0.0, 0.0, (z[0] + z[1]) / 2.0], [0.0; 3])
}

fn words(list: &[&str]) -> Vec<String> {
    list.iter().map(|w| (*w).to_owned()).collect()
}

/// Physics shape of the mug: a base, a ring of wall boxes, three boxes along the handle.
fn mug_parts(size: &MugSize) -> Vec<CollisionPart> {
    const WALLS: usize = 16;
    let mut parts = vec![upright(size.radius, [0.0, size.base])];
    let middle = size.radius - size.wall / 2.0;
    let angle = TAU / WALLS as f64;
    // Long enough to meet the neighbours at the outer radius.
    let half =
        [size.wall / 2.0, size.radius * (angle / 2.0).tan(), (size.height - size.base) / 2.0];
    for k in 0..WALLS {
        let a = angle * k as f64;
        let xyz = [middle * a.cos(), middle * a.sin(), (size.base + size.height) / 2.0];
        parts.push(part(PartShape::Box { half_extents: half }, xyz, [0.0, 0.0, a]));
    }
    let (w, t) = (size.handle_width / 2.0, size.handle_thickness / 2.0);
    let (low, high) = (size.handle_z[0], size.handle_z[1]);
    let reach = size.handle_reach / 2.0;
    for z in [low + t, high - t] {
        let xyz = [size.radius + reach, 0.0, z];
        let shape = PartShape::Box { half_extents: [reach, w, t] };
        parts.push(part(shape, xyz, [0.0; 3]));
    }
    let upright = [size.radius + size.handle_reach - t, 0.0, (low + high) / 2.0];
    let shape = PartShape::Box { half_extents: [t, w, (high - low) / 2.0 - 2.0 * t] };
    parts.push(part(shape, upright, [0.0; 3]));
    parts
}

/// A squeeze bottle: revolved, then pressed to an oval of 90 x 63 mm.
fn bottle_mesh() -> Mesh {
    let profile = [
        [0.0, 0.0],
        [0.040, 0.0],
        [0.0435, 0.002],
        [0.045, 0.006],
        [0.045, 0.030],
        [0.0445, 0.032],
        [0.0435, 0.070],
        [0.0445, 0.108],
        [0.045, 0.110],
        [0.044, 0.118],
        [0.040, 0.130],
        [0.031, 0.141],
        [0.021, 0.148],
        [0.0165, 0.151],
        [0.0165, 0.153],
        [0.0180, 0.153],
        [0.0175, 0.166],
        [0.0130, 0.169],
        [0.0080, 0.170],
        [0.0058, 0.180],
        [0.0040, 0.188],
        [0.0025, 0.190],
        [0.0, 0.190],
    ];
    let color = |z: f64| match z {
        z if z > 0.152 => CAP,
        z if z > 0.031 && z < 0.109 => LABEL,
        _ => YELLOW,
    };
    let colors: Vec<[u8; 3]> =
        profile.windows(2).map(|w| color((w[0][1] + w[1][1]) / 2.0)).collect();
    lathe(&profile, 48, &colors).stretched([1.0, 0.7, 1.0])
}

fn bottle_parts() -> Vec<CollisionPart> {
    let slab = |x: f64, y: f64, z: [f64; 2]| {
        let shape = PartShape::Box { half_extents: [x, y, (z[1] - z[0]) / 2.0] };
        part(shape, [0.0, 0.0, (z[0] + z[1]) / 2.0], [0.0; 3])
    };
    vec![
        // An oval as three boxes over one another, crosswise.
        slab(0.043, 0.0150, [0.0, 0.128]),
        slab(0.034, 0.0225, [0.0, 0.128]),
        slab(0.018, 0.0312, [0.0, 0.128]),
        slab(0.028, 0.0190, [0.128, 0.143]),
        upright(0.0165, [0.143, 0.168]),
        upright(0.006, [0.168, 0.190]),
    ]
}

fn all() -> Vec<Made> {
    let z_axis = Symmetry::Continuous { axis: [0.0, 0.0, 1.0] };
    let half_turn = Symmetry::Discrete { rotations: vec![[0.0, 0.0, 1.0, 0.0]] };
    let size = MugSize::default();
    let base = |name: &str| ObjectFile {
        name: name.to_owned(),
        synonyms: vec![],
        colors: vec![],
        mesh: "mesh.obj".to_owned(),
        seen: None,
        symmetry: Symmetry::None,
        mass: 0.1,
        friction: 0.6,
        palette: vec![],
        collision: vec![],
    };
    vec![
        Made {
            comment: "A mug with a handle. Origin: middle of the underside; z up, +x to the handle.",
            file: ObjectFile {
                synonyms: words(&["cup", "coffee cup", "coffee mug", "beaker"]),
                colors: words(&["blue"]),
                mass: 0.25,
                friction: 0.7,
                palette: vec![BLUE, CREAM],
                collision: mug_parts(&size),
                ..base("mug")
            },
            mesh: mug(&size, 48, BLUE, CREAM),
        },
        Made {
            comment: "A cork coaster. Origin: middle of the underside, z up.",
            file: ObjectFile {
                synonyms: words(&["mat", "drink mat", "saucer", "beer mat"]),
                colors: words(&["red", "brown"]),
                symmetry: z_axis.clone(),
                mass: 0.12,
                friction: 0.8,
                palette: vec![CORK],
                collision: vec![upright(0.050, [0.0, 0.008])],
                ..base("coaster")
            },
            mesh: disc(0.050, 0.008, 64, CORK),
        },
        Made {
            comment: "A mustard squeeze bottle, oval. Origin: middle of the underside; z up, x along \
                      the long axis of the oval.",
            file: ObjectFile {
                synonyms: words(&["mustard", "mustard bottle", "squeeze bottle"]),
                colors: words(&["yellow"]),
                symmetry: half_turn,
                mass: 0.45,
                friction: 0.7,
                palette: vec![YELLOW, LABEL, CAP],
                collision: bottle_parts(),
                ..base("bottle")
            },
            mesh: bottle_mesh(),
        },
        Made {
            comment: "A flat round disc to put things on. Origin: middle of the underside, z up.",
            file: ObjectFile {
                synonyms: words(&["plate", "round plate", "target"]),
                colors: words(&["green"]),
                symmetry: z_axis,
                mass: 0.15,
                friction: 0.8,
                palette: vec![GREEN],
                collision: vec![upright(0.060, [0.0, 0.006])],
                ..base("disc")
            },
            mesh: disc(0.060, 0.006, 64, GREEN),
        },
        Made {
            comment: "A wooden cube of 85 mm. Origin: its middle.",
            file: ObjectFile {
                synonyms: words(&["block", "box", "picture cube"]),
                colors: words(&["wooden", "brown", "beige"]),
                symmetry: Symmetry::Cube,
                mass: 0.3,
                friction: 0.6,
                palette: vec![WOOD],
                collision: vec![part(
                    PartShape::Box { half_extents: [0.0425; 3] },
                    [0.0; 3],
                    [0.0; 3],
                )],
                ..base("cube")
            },
            mesh: rounded_cuboid([0.085; 3], 0.002, WOOD),
        },
    ]
}

fn numbers<T: Copy + Into<f64>>(list: &[T]) -> String {
    let text = list.iter().map(|&v| {
        let v: f64 = v.into();
        let s = format!("{v:.5}");
        let s = s.trim_end_matches('0').trim_end_matches('.');
        if s == "-0" { "0".to_owned() } else { s.to_owned() }
    });
    format!("[{}]", text.collect::<Vec<_>>().join(", "))
}

fn yaml(made: &Made) -> String {
    let f = &made.file;
    let mut out =
        format!("# {}\n# Made by crates/rendering/examples/make_objects.rs\n", made.comment);
    let symmetry = match &f.symmetry {
        Symmetry::None => "none".to_owned(),
        Symmetry::Cube => "cube".to_owned(),
        Symmetry::Continuous { axis } => format!("{{continuous: {{axis: {}}}}}", numbers(axis)),
        Symmetry::Discrete { rotations } => {
            let list: Vec<String> = rotations.iter().map(|q| numbers(q)).collect();
            format!("{{discrete: {{rotations: [{}]}}}}", list.join(", "))
        }
    };
    let palette: Vec<String> = f.palette.iter().map(|c| numbers(c)).collect();
    let seen = f.seen.as_ref().map_or(String::new(), |file| format!("seen: {file}\n"));
    // Writing into a String cannot fail.
    let _ = write!(
        out,
        "name: {}\nsynonyms: [{}]\ncolors: [{}]\nmesh: {}\n{seen}symmetry: {symmetry}\nmass: {}\n\
         friction: {}\npalette: [{}]\ncollision:\n",
        f.name,
        f.synonyms.join(", "),
        f.colors.join(", "),
        f.mesh,
        f.mass,
        f.friction,
        palette.join(", ")
    );
    for p in &f.collision {
        let shape = match p.shape {
            PartShape::Box { half_extents } => {
                format!("{{box: {{half_extents: {}}}}}", numbers(&half_extents))
            }
            PartShape::Cylinder { radius, height } => {
                format!("{{cylinder: {{radius: {radius}, height: {height:.5}}}}}")
            }
        };
        let _ = write!(out, "  - {{shape: {shape}, xyz: {}", numbers(&p.xyz));
        if p.rpy != [0.0; 3] {
            let _ = write!(out, ", rpy: {}", numbers(&p.rpy));
        }
        out += "}\n";
    }
    out
}

/// Every file with its contents, relative to `config/objects`.
pub fn files() -> Vec<(PathBuf, String)> {
    let mut out = Vec::new();
    let mut all: Vec<Made> = all().into_iter().chain(task_objects::all()).collect();
    for (name, belongs) in task_objects::BELONGS {
        let find = |n: &str| all.iter().find(|m| m.file.name == n);
        let (Some(object), Some(more)) = (find(name), find(belongs)) else { continue };
        let mut whole = object.mesh.clone();
        whole.append(&more.mesh);
        let palette = [object.file.palette.clone(), more.file.palette.clone()].concat();
        let (obj, mtl) = whole.to_obj("seen.mtl");
        out.push((Path::new(name).join("seen.obj"), obj));
        out.push((Path::new(name).join("seen.mtl"), mtl));
        if let Some(made) = all.iter_mut().find(|m| m.file.name == name) {
            made.file.seen = Some("seen.obj".into());
            made.file.palette = palette;
        }
    }
    for made in all {
        let dir = PathBuf::from(&made.file.name);
        let (obj, mtl) = made.mesh.to_obj("mesh.mtl");
        out.push((dir.join("object.yaml"), yaml(&made)));
        out.push((dir.join("mesh.obj"), obj));
        out.push((dir.join("mesh.mtl"), mtl));
    }
    out
}

/// Where they belong.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects")
}

#[allow(dead_code)]
fn main() -> std::io::Result<()> {
    for (name, text) in files() {
        let path = root().join(name);
        if let Some(dir) = path.parent() {
            std::fs::create_dir_all(dir)?;
        }
        std::fs::write(path, text)?;
    }
    Ok(())
}
