//! Objects of the benchmark's tasks: toy, card, ring, peg, wall, tumbler, drawer, plug, tissue.

use super::{Made, part, upright, words};
use std::f64::consts::{PI, TAU};
use tdv_geometry::{Pose, Symmetry, pose_from_xyz_rpy};
use tdv_rendering::mesh::primitives::{
    cuboid, cylinder, disc, lathe, rounded_cuboid, sphere, tapered_capsule,
};
use tdv_rendering::{CollisionPart, Mesh, ObjectFile, PartShape};

const FUR: [u8; 3] = [64, 112, 186];
const BELLY: [u8; 3] = [168, 204, 232];
const PINK: [u8; 3] = [222, 132, 164];
const DARK: [u8; 3] = [34, 34, 44];
const ORANGE: [u8; 3] = [236, 140, 52];
const RED: [u8; 3] = [196, 44, 48];
const YELLOW: [u8; 3] = [236, 196, 44];
const GREEN: [u8; 3] = [58, 132, 84];
const SLATE: [u8; 3] = [92, 104, 122];
const TEAL: [u8; 3] = [36, 140, 140];
const PALE: [u8; 3] = [214, 236, 232];
const OAK: [u8; 3] = [178, 132, 82];
const WALNUT: [u8; 3] = [122, 80, 50];
const STEEL: [u8; 3] = [188, 192, 198];
const WHITE: [u8; 3] = [236, 236, 232];
const VIOLET: [u8; 3] = [118, 74, 152];

fn block(half: [f64; 3], xyz: [f64; 3]) -> CollisionPart {
    part(PartShape::Box { half_extents: half }, xyz, [0.0; 3])
}

/// Between two corners.
fn span(low: [f64; 3], high: [f64; 3]) -> CollisionPart {
    let half = std::array::from_fn(|k| (high[k] - low[k]) / 2.0);
    block(half, std::array::from_fn(|k| (high[k] + low[k]) / 2.0))
}

/// What boxes and cylinders look like.
fn look(parts: &[CollisionPart], color: [u8; 3]) -> Mesh {
    let mut out = Mesh::default();
    for p in parts {
        let mesh = match p.shape {
            PartShape::Box { half_extents } => {
                let size = half_extents.map(|h| 2.0 * h);
                // Rounding takes a thousand triangles: for what has few parts.
                if parts.len() == 1 {
                    rounded_cuboid(size, 0.001, color)
                } else {
                    cuboid(size, color)
                }
            }
            PartShape::Cylinder { radius, height } => cylinder(radius, height, 24, color)
                .transformed(&Pose::translation(0.0, 0.0, -height / 2.0)),
        };
        out.append(&mesh.transformed(&p.pose()));
    }
    out
}

fn turns(n: usize) -> Symmetry {
    let about = |k: usize| {
        let half = PI * k as f64 / n as f64;
        [0.0, 0.0, half.sin(), half.cos()]
    };
    Symmetry::Discrete { rotations: (1..n).map(about).collect() }
}

fn file(name: &str, synonyms: &[&str], colors: &[&str], mass: f64, friction: f64) -> ObjectFile {
    ObjectFile {
        name: name.to_owned(),
        synonyms: words(synonyms),
        colors: words(colors),
        mesh: "mesh.obj".to_owned(),
        seen: None,
        symmetry: Symmetry::None,
        mass,
        friction,
        palette: vec![],
        collision: vec![],
    }
}

fn ball(at: [f64; 3], half: [f64; 3], roll: f64, segments: usize, color: [u8; 3]) -> Mesh {
    let unit = sphere(1.0, segments, color).stretched(half);
    unit.transformed(&pose_from_xyz_rpy(at, [roll, 0.0, 0.0]))
}

/// Rounded body, head and ears; the face looks along +x.
fn toy() -> Made {
    let mut mesh = Mesh::default();
    for piece in [
        ball([0.0, 0.0, 0.034], [0.027, 0.030, 0.034], 0.0, 14, FUR),
        ball([0.006, 0.0, 0.036], [0.0225, 0.021, 0.024], 0.0, 10, BELLY),
        ball([0.002, 0.0, 0.082], [0.025, 0.033, 0.026], 0.0, 14, FUR),
        ball([0.0, 0.045, 0.091], [0.0055, 0.022, 0.011], 0.45, 10, FUR),
        ball([0.0, -0.045, 0.091], [0.0055, 0.022, 0.011], -0.45, 10, FUR),
        ball([0.003, 0.046, 0.091], [0.004, 0.017, 0.007], 0.45, 8, PINK),
        ball([0.003, -0.046, 0.091], [0.004, 0.017, 0.007], -0.45, 8, PINK),
        ball([0.0255, 0.0, 0.078], [0.006, 0.007, 0.005], 0.0, 8, DARK),
        ball([0.0205, 0.014, 0.087], [0.006, 0.006, 0.008], 0.3, 8, DARK),
        ball([0.0205, -0.014, 0.087], [0.006, 0.006, 0.008], -0.3, 8, DARK),
        ball([0.012, 0.018, 0.009], [0.0135, 0.010, 0.009], 0.0, 8, FUR),
        ball([0.012, -0.018, 0.009], [0.0135, 0.010, 0.009], 0.0, 8, FUR),
        ball([0.012, 0.027, 0.046], [0.008, 0.007, 0.011], 0.6, 8, FUR),
        ball([0.012, -0.027, 0.046], [0.008, 0.007, 0.011], -0.6, 8, FUR),
        ball([-0.028, 0.0, 0.018], [0.008, 0.007, 0.007], 0.0, 8, BELLY),
    ] {
        mesh.append(&piece);
    }
    let mut collision = vec![
        span([-0.020, -0.026, 0.0], [0.022, 0.026, 0.016]),
        span([-0.026, -0.014, 0.014], [0.026, 0.014, 0.060]),
        span([-0.016, -0.029, 0.016], [0.016, 0.029, 0.056]),
        span([-0.022, -0.024, 0.058], [0.026, 0.024, 0.106]),
        span([-0.012, -0.032, 0.066], [0.014, 0.032, 0.098]),
        block([0.003, 0.004, 0.004], [0.0275, 0.0, 0.078]),
        block([0.006, 0.005, 0.005], [-0.0285, 0.0, 0.018]),
    ];
    for side in [1.0, -1.0] {
        let shape = PartShape::Box { half_extents: [0.004, 0.018, 0.007] };
        collision.push(part(shape, [0.0, side * 0.045, 0.091], [side * 0.45, 0.0, 0.0]));
    }
    Made {
        comment: "A soft toy with a head and two ears, rigid here. Origin: middle of the underside; z \
                  up, +x where it looks.",
        file: ObjectFile {
            palette: vec![FUR, BELLY, PINK, DARK],
            collision,
            ..file(
                "toy",
                &["stitch", "soft toy", "plush toy", "stuffed animal", "doll"],
                &["blue"],
                0.12,
                0.9,
            )
        },
        mesh,
    }
}

/// A square ring, 50 mm outside with a hole of 30 mm.
fn ring() -> Made {
    let h = 0.024;
    let parts = vec![
        span([0.015, -0.025, 0.0], [0.025, 0.025, h]),
        span([-0.025, -0.025, 0.0], [-0.015, 0.025, h]),
        span([-0.015, 0.015, 0.0], [0.015, 0.025, h]),
        span([-0.015, -0.025, 0.0], [0.015, -0.015, h]),
    ];
    let mesh = look(&parts, RED);
    Made {
        comment: "A square ring of 50 mm with a hole of 30 mm. Origin: middle of the underside, z up.",
        file: ObjectFile {
            symmetry: turns(4),
            palette: vec![RED],
            collision: parts,
            ..file("ring", &["square ring", "frame"], &["red"], 0.10, 0.6)
        },
        mesh,
    }
}

fn peg() -> Made {
    let parts = vec![
        span([-0.05, -0.05, 0.0], [0.05, 0.05, 0.010]),
        span([-0.0125, -0.0125, 0.010], [0.0125, 0.0125, 0.072]),
        // The tip is drawn in, as a turned peg's would be.
        span([-0.011, -0.011, 0.072], [0.011, 0.011, 0.080]),
    ];
    let mut mesh = look(&parts[..1], GREEN);
    mesh.append(&look(&parts[1..], YELLOW));
    Made {
        comment: "A square peg of 25 mm on a base plate. Origin: middle of the underside, z up.",
        file: ObjectFile {
            symmetry: turns(4),
            palette: vec![GREEN, YELLOW],
            collision: parts,
            ..file("peg", &["square peg", "post", "pillar"], &["green", "yellow"], 0.8, 0.4)
        },
        mesh,
    }
}

fn tumbler() -> Made {
    const WALLS: usize = 20;
    let (r, h, wall, base) = (0.045, 0.080, 0.003, 0.005);
    let inner = r - wall;
    let profile = [
        [0.0, 0.0],
        [r - 0.002, 0.0],
        [r, 0.002],
        [r, h - 0.001],
        [r - 0.001, h],
        [inner + 0.001, h],
        [inner, h - 0.001],
        [inner, base],
        [0.0, base],
    ];
    let colors = [TEAL, TEAL, TEAL, TEAL, TEAL, PALE, PALE, PALE];
    let mut parts = vec![upright(r, [0.0, base])];
    let angle = TAU / WALLS as f64;
    let half = [wall / 2.0, r * (angle / 2.0).tan(), (h - base) / 2.0];
    for k in 0..WALLS {
        let (a, m) = (angle * k as f64, r - wall / 2.0);
        let xyz = [m * a.cos(), m * a.sin(), (base + h) / 2.0];
        parts.push(part(PartShape::Box { half_extents: half }, xyz, [0.0, 0.0, a]));
    }
    Made {
        comment: "A wide tumbler without a handle. Origin: middle of the underside, z up.",
        file: ObjectFile {
            symmetry: Symmetry::Continuous { axis: [0.0, 0.0, 1.0] },
            palette: vec![TEAL, PALE],
            collision: parts,
            ..file(
                "tumbler",
                &["glass", "drinking glass", "bowl"],
                &["turquoise", "green"],
                0.40,
                0.7,
            )
        },
        mesh: lathe(&profile, 48, &colors),
    }
}

/// Open at +x, where the drawer comes out.
/// What is seen with an object, in the same frame.
pub const BELONGS: [(&str, &str); 2] = [("cabinet", "drawer"), ("tissue_box", "tissue")];

fn cabinet() -> Made {
    let parts = vec![
        span([-0.080, -0.090, 0.0], [0.080, 0.090, 0.008]),
        span([-0.080, -0.090, 0.102], [0.080, 0.090, 0.110]),
        span([-0.080, 0.082, 0.008], [0.080, 0.090, 0.102]),
        span([-0.080, -0.090, 0.008], [0.080, -0.082, 0.102]),
        span([-0.080, -0.082, 0.008], [-0.072, 0.082, 0.102]),
    ];
    Made {
        comment: "A cabinet open at +x, for the drawer. Origin: middle of the underside, z up.",
        file: ObjectFile {
            palette: vec![OAK],
            collision: parts.clone(),
            ..file("cabinet", &["chest", "chest of drawers"], &["brown"], 2.0, 0.6)
        },
        mesh: look(&parts, OAK),
    }
}

fn drawer() -> Made {
    let tray = vec![
        span([0.081, -0.088, 0.010], [0.089, 0.088, 0.100]),
        span([-0.070, -0.078, 0.014], [0.081, 0.078, 0.020]),
        span([-0.070, 0.074, 0.020], [0.081, 0.078, 0.070]),
        span([-0.070, -0.078, 0.020], [0.081, -0.074, 0.070]),
        span([-0.070, -0.074, 0.020], [-0.066, 0.074, 0.070]),
    ];
    let handle = vec![
        part(PartShape::Cylinder { radius: 0.012, height: 0.064 }, [0.145, 0.0, 0.058], [0.0; 3]),
        span([0.089, -0.004, 0.032], [0.145, 0.004, 0.040]),
        span([0.089, -0.004, 0.076], [0.145, 0.004, 0.084]),
    ];
    let mut mesh = look(&tray, WALNUT);
    mesh.append(&look(&handle, STEEL));
    Made {
        comment: "A drawer with an upright handle bar at +x. Origin: the cabinet's when it is shut.",
        file: ObjectFile {
            palette: vec![WALNUT, STEEL],
            collision: [tray, handle].concat(),
            ..file("drawer", &["tray"], &["brown"], 0.5, 0.6)
        },
        mesh,
    }
}

/// A layer with square holes of half width `hole` at the given x.
fn layer(z: [f64; 2], holes: &[f64], hole: f64) -> Vec<CollisionPart> {
    let (x, y) = (0.080, 0.030);
    let mut out =
        vec![span([-x, hole, z[0]], [x, y, z[1]]), span([-x, -y, z[0]], [x, -hole, z[1]])];
    let mut from = -x;
    for at in holes {
        out.push(span([from, -hole, z[0]], [at - hole, hole, z[1]]));
        from = at + hole;
    }
    out.push(span([from, -hole, z[0]], [x, hole, z[1]]));
    out
}

fn socket() -> Made {
    let hole = 0.0085;
    let floor = vec![span([-0.080, -0.030, 0.0], [0.080, 0.030, 0.006])];
    let deep = layer([0.006, 0.020], &[0.045], hole);
    let top = layer([0.020, 0.030], &[-0.045, 0.045], hole);
    let mut mesh = look(&floor, DARK);
    mesh.append(&look(&deep, SLATE));
    mesh.append(&look(&top, WHITE));
    // A frame round the socket tells it from the place where the plug is parked.
    for (at, size) in [
        ([0.045, 0.0115, 0.0303], [0.029, 0.005, 0.0006]),
        ([0.045, -0.0115, 0.0303], [0.029, 0.005, 0.0006]),
        ([0.0565, 0.0, 0.0303], [0.005, 0.019, 0.0006]),
        ([0.0335, 0.0, 0.0303], [0.005, 0.019, 0.0006]),
    ] {
        mesh.append(&cuboid(size, RED).transformed(&Pose::translation(at[0], at[1], at[2])));
    }
    Made {
        comment: "A block with a square socket at +x and a shallow hole at -x where the plug is parked. \
                  Origin: middle of the underside, z up.",
        file: ObjectFile {
            palette: vec![WHITE, SLATE, RED],
            collision: [floor, deep, top].concat(),
            ..file("socket", &["outlet", "socket block", "power strip"], &["white"], 1.0, 0.3)
        },
        mesh,
    }
}

fn plug() -> Made {
    let parts = vec![
        span([-0.006, -0.006, 0.003], [0.006, 0.006, 0.026]),
        span([-0.0045, -0.0045, 0.0], [0.0045, 0.0045, 0.003]),
        span([-0.012, -0.015, 0.026], [0.012, 0.015, 0.070]),
    ];
    let mut mesh = look(&parts[..2], STEEL);
    mesh.append(&look(&parts[2..], VIOLET));
    let cord = tapered_capsule(0.004, 0.003, 0.012, 12, DARK);
    mesh.append(&cord.transformed(&Pose::translation(0.0, 0.0, 0.066)));
    Made {
        comment: "A plug with a square tip of 12 mm. Origin: the tip's end, z up the body.",
        file: ObjectFile {
            symmetry: turns(2),
            palette: vec![VIOLET, STEEL],
            collision: [parts, vec![upright(0.003, [0.070, 0.080])]].concat(),
            ..file("plug", &["connector", "power plug"], &["purple"], 0.08, 0.5)
        },
        mesh,
    }
}

fn tissue_box() -> Made {
    let parts = vec![
        span([-0.060, -0.040, 0.0], [0.060, 0.040, 0.004]),
        span([-0.060, 0.006, 0.004], [0.060, 0.040, 0.050]),
        span([-0.060, -0.040, 0.004], [0.060, -0.006, 0.050]),
        span([-0.060, -0.006, 0.004], [-0.036, 0.006, 0.050]),
        span([0.036, -0.006, 0.004], [0.060, 0.006, 0.050]),
    ];
    let mut mesh = look(&parts, TEAL);
    let stripe = cuboid([0.012, 0.060, 0.0006], YELLOW);
    mesh.append(&stripe.transformed(&Pose::translation(0.048, 0.0, 0.0503)));
    Made {
        comment: "A tissue box with a slot along x. Origin: middle of the underside, z up.",
        file: ObjectFile {
            palette: vec![TEAL, YELLOW],
            collision: parts,
            ..file(
                "tissue_box",
                &["box of tissues", "tissue dispenser"],
                &["turquoise", "green"],
                0.5,
                0.6,
            )
        },
        mesh,
    }
}

/// A stand-in: cloth is not simulated.
fn tissue() -> Made {
    let parts = vec![span([-0.030, -0.003, 0.006], [0.030, 0.003, 0.104])];
    Made {
        comment: "A rigid tab in place of a tissue. Origin: that of the tissue box while it is inside.",
        file: ObjectFile {
            symmetry: turns(2),
            palette: vec![WHITE],
            collision: parts.clone(),
            ..file("tissue", &["paper tissue", "napkin", "tab"], &["white"], 0.1, 0.8)
        },
        mesh: look(&parts, WHITE),
    }
}

pub fn all() -> Vec<Made> {
    let card = Made {
        comment: "A thin round card. Origin: middle of the underside, z up.",
        file: ObjectFile {
            symmetry: Symmetry::Continuous { axis: [0.0, 0.0, 1.0] },
            palette: vec![ORANGE],
            collision: vec![upright(0.055, [0.0, 0.002])],
            ..file("card", &["round card", "paper"], &["orange"], 0.03, 0.8)
        },
        mesh: disc(0.055, 0.002, 64, ORANGE),
    };
    let parts = vec![span([-0.080, -0.006, 0.0], [0.080, 0.006, 0.110])];
    let wall = Made {
        comment: "A wall to be passed over. Origin: middle of the underside, z up, long along x.",
        file: ObjectFile {
            symmetry: turns(2),
            palette: vec![SLATE],
            collision: parts.clone(),
            ..file("wall", &["fence", "barrier"], &["grey"], 2.0, 0.5)
        },
        mesh: look(&parts, SLATE),
    };
    vec![
        toy(),
        card,
        ring(),
        peg(),
        wall,
        tumbler(),
        cabinet(),
        drawer(),
        socket(),
        plug(),
        tissue_box(),
        tissue(),
    ]
}
