//! `tdv object add`: a new entry of the object catalogue, from a mesh, a recording, or both.

use crate::arguments::ObjectAddArgs;
use anyhow::{Context as _, bail};
use std::path::Path;
use tdv_geometry::{Pose, Symmetry};
use tdv_perception::candidates::{Candidate, candidates, of_color, only};
use tdv_perception::entry::{EntryWords, make_entry, save_entry};
use tdv_perception::reconstruct::{ReconstructConfig, Reconstruction};
use tdv_perception::scale::{ScaleConfig, ScaleReport, estimate_scale};
use tdv_perception::{ObjectModel, RgbdFrame, Tracker, TrackerConfig, average_frames};
use tdv_rendering::shape::{find_symmetry, standing};
use tdv_rendering::{Instance, Intrinsics, Lighting, Mesh, Rendered, Renderer, RgbImage, look_at};
use tdv_runtime::camera_bag::CameraBag;

/// Larger meshes are thinned out: the tracker draws them several times a frame.
const MOST_TRIANGLES: usize = 20_000;
/// A glTF larger than this (m) has no unit, whatever the format says.
const UNIT_LESS: f64 = 0.5;
/// Part of the edges that may be without inside and outside.
const BROKEN: f64 = 0.05;
/// Seed of every random choice.
const SEED: u64 = 1;
/// Least confidence of a tracked pose whose view is used.
const CONFIDENT: f64 = 0.75;

/// Makes the entry and says what was found.
pub fn add(args: &ObjectAddArgs) -> anyhow::Result<()> {
    let name = args.name.to_lowercase();
    let plain = name.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '-');
    if name.is_empty() || !plain {
        bail!("{:?} is no name: letters, digits, '_' and '-' only", args.name);
    }
    let folder = args.objects.join(&name);
    if folder.exists() && !args.force {
        bail!("{} is there already; --force replaces it", folder.display());
    }
    let (mesh, symmetry, origin) = match (&args.mesh, &args.bag) {
        (Some(mesh), bag) => from_mesh(mesh, bag.as_deref(), args)?,
        (None, Some(bag)) => from_views(bag, args)?,
        (None, None) => bail!("--mesh, --bag or both"),
    };
    mesh.check_size(&folder)?;
    let words = EntryWords {
        name: name.clone(),
        synonyms: args.synonyms.clone(),
        mass: args.mass,
        friction: args.friction,
    };
    let (mesh, file) = make_entry(&words, &mesh, symmetry);
    let comment = format!("Made by `tdv object add` {origin}.\nMass and friction are guesses.");
    save_entry(&folder, &mesh, &file, &comment)?;
    // Whatever was written must be what the catalogue reads.
    ObjectModel::load(&folder)?;
    let picture = folder.join("turntable.gif");
    let turns = turntable(&mesh, 24);
    crate::picture::save_gif(&picture, &turns, 80)?;
    let sheet = folder.join("views.png");
    contact_sheet(&turns, 3).save(&sheet).with_context(|| sheet.display().to_string())?;
    let size = mesh.bounds().1 - mesh.bounds().0;
    println!("size:      {:.0} x {:.0} x {:.0} mm", size.x * 1e3, size.y * 1e3, size.z * 1e3);
    println!("symmetry:  {:?}", file.symmetry);
    println!("colours:   {}", file.colors.join(", "));
    println!("parts:     {} for collisions", file.collision.len());
    let guess = if args.mass.is_none() { " (a guess)" } else { "" };
    println!("mass:      {} kg{guess}", file.mass);
    println!(
        "mesh:      {} triangles, {}",
        mesh.triangles.len(),
        folder.join(&file.mesh).display()
    );
    println!("pictures:  {}, {}", picture.display(), sheet.display());
    Ok(())
}

/// A mesh file, brought to metres.
fn from_mesh(
    path: &Path,
    bag: Option<&Path>,
    args: &ObjectAddArgs,
) -> anyhow::Result<(Mesh, Symmetry, String)> {
    let loaded = Mesh::load_unscaled(path)?;
    let edges = loaded.topology();
    if edges.broken(BROKEN) {
        bail!(
            "{}: of {} edges {} have more than two faces and {} are wound against each other: the \
             surface has no inside; repair it first",
            path.display(),
            edges.edges,
            edges.crowded,
            edges.twisted
        );
    }
    if edges.open > 0 {
        println!("note:      the mesh has holes ({} of {} edges)", edges.open, edges.edges);
    }
    let mesh = standing(&loaded.outward().simplified(MOST_TRIANGLES));
    let symmetry = report_symmetry(&mesh);
    let height = mesh.bounds().1.z;
    let scale = match (args.scale, args.height, bag) {
        (Some(scale), _, _) => scale,
        (None, Some(wanted), _) => wanted / height.max(1e-12),
        (None, None, Some(bag)) => {
            let (frame, _) = still_view(bag, args.frames)?;
            let report = best_scale(&frame, &mesh, &symmetry, args)?;
            println!(
                "scale:     {:.5} m a unit, estimates within {:.1} %, agreement {:.2}",
                report.scale,
                report.spread * 100.0,
                report.score
            );
            for e in &report.estimates {
                println!("           {:13} {:.5} +- {:.1} %", e.name, e.value, e.sigma * 100.0);
            }
            report.scale
        }
        (None, None, None) => {
            let gltf = path.extension().is_some_and(|e| e == "glb" || e == "gltf");
            if gltf && mesh.diameter() > UNIT_LESS {
                bail!(
                    "{} is {:.2} units across and glTF made from pictures has no unit: give --bag with a \
                     view of the object, --height (m) or --scale",
                    path.display(),
                    mesh.diameter()
                );
            }
            1.0
        }
    };
    if !(scale > 0.0 && scale.is_finite()) {
        bail!("a scale of {scale} makes no mesh");
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Ok((mesh.scaled(scale), symmetry, format!("from {name}, scaled by {scale:.5}")))
}

fn report_symmetry(mesh: &Mesh) -> Symmetry {
    let found = find_symmetry(mesh, SEED);
    if found.colors_differ {
        println!(
            "note:      the shape is symmetric, the colours are not: poses count as equal all the same"
        );
    }
    found.symmetry
}

/// The mean of the first frames, and those that come after.
fn still_view(bag: &Path, frames: usize) -> anyhow::Result<(RgbdFrame, CameraBag)> {
    let mut recording = CameraBag::open(bag)?;
    let mut first = Vec::new();
    while first.len() < frames.max(1)
        && let Some(f) = next(&mut recording)?
    {
        first.push(f);
    }
    let mean = average_frames(&first)
        .with_context(|| format!("{} holds no usable frame", bag.display()))?;
    Ok((mean, recording))
}

fn next(recording: &mut CameraBag) -> anyhow::Result<Option<RgbdFrame>> {
    Ok(recording.next_frame()?.map(|f| RgbdFrame {
        stamp: f.stamp,
        color: f.color,
        depth: f.depth,
        intrinsics: f.intrinsics,
    }))
}

/// The size of the mesh as the thing on the table that it agrees with best.
fn best_scale(
    frame: &RgbdFrame,
    mesh: &Mesh,
    symmetry: &Symmetry,
    args: &ObjectAddArgs,
) -> anyhow::Result<ScaleReport> {
    let (table, all) = candidates(frame)?;
    let some = of_color(&all, args.prompt.as_deref().unwrap_or(""))?;
    let config = ScaleConfig::default();
    let mut best: Option<ScaleReport> = None;
    let mut refused = String::new();
    for c in &some {
        match estimate_scale(frame, &table, &c.cluster, &c.mask, mesh, symmetry, &config) {
            Ok(r) if best.as_ref().is_none_or(|b| r.score > b.score) => best = Some(r),
            Ok(_) => {}
            Err(e) => refused += &format!("\n  {c}: {e}"),
        }
    }
    best.with_context(|| format!("no scale from this view:{refused}"))
}

/// A mesh from the recording alone.
fn from_views(bag: &Path, args: &ObjectAddArgs) -> anyhow::Result<(Mesh, Symmetry, String)> {
    let (frame, mut rest) = still_view(bag, args.frames)?;
    let (table, all) = candidates(&frame)?;
    let some: Vec<&Candidate> = of_color(&all, args.prompt.as_deref().unwrap_or(""))?;
    let thing = only(&some)?;
    println!("seen:      {thing}");
    let mut shape = Reconstruction::start(&frame, &table, thing, ReconstructConfig::default())?;
    println!(
        "unseen:    made with {}; {:.0} % of the points contradict it",
        shape.assumed(),
        shape.violation() * 100.0
    );
    if args.carried {
        watch(&frame, &mut rest, &mut shape)?;
        println!("views:     {} later ones used", shape.later_views());
    }
    let mesh = shape.mesh()?;
    let mesh = match (args.scale, args.height) {
        (Some(s), _) => mesh.scaled(s),
        (None, Some(h)) => mesh.scaled(h / mesh.bounds().1.z.max(1e-9)),
        (None, None) => mesh,
    };
    let symmetry = report_symmetry(&mesh);
    let name = bag.file_name().unwrap_or_default().to_string_lossy();
    Ok((
        mesh,
        symmetry,
        format!("from views in {name}; the unseen side was made with {}", shape.assumed()),
    ))
}

/// Follows the object through the rest of the recording and lets every sure view cut.
fn watch(
    first: &RgbdFrame,
    rest: &mut CameraBag,
    shape: &mut Reconstruction,
) -> anyhow::Result<()> {
    let model = ObjectModel::new("thing", shape.mesh()?, Symmetry::None);
    let start: Pose = shape.pose();
    let mut tracker = Tracker::start(first, model.into(), &start, TrackerConfig::default());
    while let Some(frame) = next(rest)? {
        let tracked = tracker.track(&frame, true);
        let (moved, turned) = tdv_geometry::pose_distance(&tracked.pose, &start);
        // A view from where it stood shows nothing new.
        if tracked.confidence > CONFIDENT && (moved > 0.03 || turned > 0.1) {
            shape.see_through(&frame, &tracked.pose);
        }
    }
    Ok(())
}

/// The object from all sides, slightly from above.
fn turntable(mesh: &Mesh, count: usize) -> Vec<RgbImage> {
    let k = Intrinsics { width: 320, height: 320, fx: 420.0, fy: 420.0, cx: 159.5, cy: 159.5 };
    let lighting = Lighting { background: [245; 3], ..Lighting::default() };
    let (mut renderer, mut out) = (Renderer::new(), Rendered::default());
    let (middle, far) = (mesh.center(), 1.6 * mesh.diameter());
    (0..count)
        .map(|i| {
            let a = std::f64::consts::TAU * i as f64 / count as f64;
            let up = if i * 4 / count == 3 { 0.9 } else { 0.45 };
            let eye = middle
                + tdv_geometry::nalgebra::Vector3::new(a.cos(), a.sin(), up).normalize() * far;
            let pose = look_at(&eye, &middle).inverse();
            renderer.render(&k, &[Instance { mesh, pose, id: 1 }], &lighting, &mut out);
            out.color.clone()
        })
        .collect()
}

/// Every `step`th picture, four in a row.
fn contact_sheet(pictures: &[RgbImage], step: usize) -> RgbImage {
    let some: Vec<&RgbImage> = pictures.iter().step_by(step.max(1)).collect();
    let (w, h) = some.first().map_or((1, 1), |p| p.dimensions());
    let rows = some.len().div_ceil(4) as u32;
    let mut out = RgbImage::new(4 * w, rows * h);
    for (i, p) in some.iter().enumerate() {
        let (x, y) = (i as u32 % 4 * w, i as u32 / 4 * h);
        image::imageops::replace(&mut out, *p, i64::from(x), i64::from(y));
    }
    out
}
