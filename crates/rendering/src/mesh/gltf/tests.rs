use super::super::primitives;
use super::*;

fn texture() -> RgbImage {
    RgbImage::from_fn(8, 8, |x, y| image::Rgb([x as u8 * 30, y as u8 * 30, 40]))
}

fn read(bytes: &[u8]) -> Result<Mesh, MeshError> {
    load(Path::new("memory.glb"), bytes)
}

#[test]
fn a_glb_written_is_the_mesh_read() {
    for textured in [false, true] {
        let mut mesh = primitives::cuboid([0.1, 0.2, 0.3], [200, 100, 50]);
        mesh.append(&primitives::cylinder(0.05, 0.2, 24, [20, 30, 240]));
        if textured {
            mesh.texture = Some(texture());
        }
        let back = read(&mesh.to_glb().unwrap()).unwrap();
        assert_eq!(back.triangles, mesh.triangles);
        assert_eq!(back.colors, mesh.colors);
        assert_eq!(back.texture, mesh.texture);
        for (a, b) in back.positions.iter().zip(&mesh.positions) {
            assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6), "{a:?} {b:?}");
        }
        for (a, b) in back.normals.iter().zip(&mesh.normals) {
            assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-5), "{a:?} {b:?}");
        }
        if textured {
            for (a, b) in back.uvs.iter().zip(&mesh.uvs) {
                assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6), "{a:?} {b:?}");
            }
        }
    }
}

/// One triangle in the xy plane with corners (0, 0), (1, 0), (0, 1), as text with embedded data.
fn text(node: &str, required: &str) -> String {
    let mut octets = Vec::new();
    for v in [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        octets.extend(v.to_le_bytes());
    }
    octets.extend([0_u8, 1, 2, 0]);
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut data = String::new();
    for c in octets.chunks(3) {
        let v = (0..3).fold(0_u32, |v, k| v << 8 | u32::from(c.get(k).copied().unwrap_or(0)));
        for k in 0..4 {
            data.push(char::from(DIGITS[(v >> (18 - 6 * k) & 63) as usize]));
        }
    }
    format!(
        r#"{{"asset":{{"version":"2.0"}},{required}"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{node}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"material":0}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[1,0,0,1]}}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
                     {{"bufferView":1,"componentType":5121,"count":3,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":3}}],
        "buffers":[{{"byteLength":40,"uri":"data:application/octet-stream;base64,{data}"}}]}}"#
    )
}

#[test]
fn nodes_move_and_y_becomes_z() {
    let node = r#"{"mesh":0,"translation":[10,20,30],"scale":[2,2,2]}"#;
    let mesh = read(text(node, "").as_bytes()).unwrap();
    // The file's (0, 1, 0) is at (10, 22, 30) there and at (10, -30, 22) here.
    assert_eq!(mesh.positions, [[10.0, -30.0, 20.0], [12.0, -30.0, 20.0], [10.0, -30.0, 22.0]]);
    assert_eq!((mesh.triangles[0], mesh.colors[0]), ([0, 1, 2], [255, 0, 0]));
    // A mirroring node turns the surface inside out unless the winding is turned as well.
    let mirrored = read(text(r#"{"mesh":0,"scale":[-1,1,1]}"#, "").as_bytes()).unwrap();
    assert_eq!(mirrored.triangles[0], [0, 2, 1]);
}

#[test]
fn damaged_documents_are_errors() {
    let good = primitives::cuboid([0.1; 3], [9, 9, 9]).to_glb().unwrap();
    for cut in [4, 8, 15, 40, good.len() / 2, good.len() - 5] {
        assert!(read(&good[..cut]).is_err(), "cut at {cut}");
    }
    // Every octet of the structure turned over once: an error or a mesh, never a panic.
    for i in (0..good.len().min(1400)).step_by(3) {
        let mut bad = good.clone();
        bad[i] ^= 0x15;
        let _ = read(&bad);
    }
    let loop_ = text(r#"{"mesh":0,"children":[0]}"#, "");
    assert!(read(loop_.as_bytes()).unwrap_err().to_string().contains("loop"));
    let packed = text(r#"{"mesh":0}"#, r#""extensionsRequired":["KHR_draco_mesh_compression"],"#);
    let e = read(packed.as_bytes()).unwrap_err().to_string();
    assert!(e.contains("KHR_draco") && e.contains("uncompressed"), "{e}");
    let far = text(r#"{"mesh":0}"#, "")
        .replace(r#""count":3,"type":"VEC3""#, r#""count":9,"type":"VEC3""#);
    assert!(read(far.as_bytes()).unwrap_err().to_string().contains("accessor 0"));
}
