use super::super::tests::{mesh_error, with_file};
use super::*;

const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
    property float z\nproperty float s\nproperty float t\nelement face 1\n\
    property list uchar int vertex_indices\nend_header\n";

fn parse(bytes: &[u8]) -> Result<RawMesh, Vec<SceneError>> {
    with_file(bytes, |file| file.ply(false))
}

#[test]
fn text_and_both_byte_orders_give_the_same_mesh() {
    let text = format!("{HEADER}0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3");
    let mesh = parse(text.as_bytes()).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
    assert_eq!(mesh.uvs[3], Vec2::new(0.0, 1.0));
    for (name, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
        let mut bytes = HEADER.replace("ascii", name).into_bytes();
        for (position, uv) in mesh.positions.iter().zip(&mesh.uvs) {
            for value in [position.x, position.y, position.z, uv.x, uv.y] {
                bytes.extend(if big { value.to_be_bytes() } else { value.to_le_bytes() });
            }
        }
        bytes.push(4);
        for index in 0..4_i32 {
            bytes.extend(if big { index.to_be_bytes() } else { index.to_le_bytes() });
        }
        assert_eq!(parse(&bytes).unwrap(), mesh);
    }
}

/// Byte order marks, comments in Latin-1, lone CRs, and normals without direction.
#[test]
fn files_of_other_programs_are_read() {
    let text = "ply\nformat ascii 1.0\ncomment @\nelement vertex 3\nproperty float x\nproperty float y\n\
        property float z\nproperty float nx\nproperty float ny\nproperty float nz\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n0 0 0 0 0 0\n1 0 0 0 0 1\n0 1 0 0 0 2\n3 0 1 2\n";
    let latin1 = |text: &str| {
        text.bytes()
            .map(|b| if b == b'@' { 0xe9 } else { b })
            .collect::<Vec<u8>>()
    };
    let mesh = parse(&latin1(text)).unwrap();
    assert_eq!(mesh.normals, [Vec3::ZERO, Vec3::Z, Vec3::Z]);
    for end in ["\r\n", "\r"] {
        let text = text.replace('\n', end);
        assert_eq!(parse(&latin1(&text)).unwrap(), mesh, "{end:?}");
        assert_eq!(
            parse(&[b"\xef\xbb\xbf", &latin1(&text)[..]].concat()).unwrap(),
            mesh,
            "{end:?}"
        );
        mesh_error(
            parse(&latin1(&text.replace("0 1 0 0 0 2", "0 1 x 0 0 2"))),
            16,
            "not a number",
        );
    }
    // A binary body may begin with the byte of a line feed, here that of a coordinate.
    let header = HEADER
        .replace("ascii", "binary_little_endian")
        .replace('\n', "\r")
        .replace("vertex 4", "vertex 3");
    let mut bytes = header.into_bytes();
    let first = f32::from_le_bytes([b'\n', 0, 0, 0x40]);
    for value in [first, 0., 0., 0., 0., 1., 0., 0., 0., 0., 0., 1., 0., 0., 0.] {
        bytes.extend(value.to_le_bytes());
    }
    bytes.push(3);
    bytes.extend([0_i32, 1, 2].iter().flat_map(|index| index.to_le_bytes()));
    assert_eq!(parse(&bytes).unwrap().positions[0].x, first);
}

#[test]
fn lies_in_the_header_are_found_before_memory_is_taken() {
    let huge = HEADER.replace("vertex 4", "vertex 18446744073709551615");
    mesh_error(parse(huge.as_bytes()), 12, "ends before");
    let text = HEADER.replace("vertex 4", "vertex 1").replace("face 1", "face 1000000");
    mesh_error(parse(format!("{text}0 0 0 0 0\n").as_bytes()), 12, "ends before");
}

#[test]
fn broken_files_are_refused_with_their_line() {
    let three = "1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n";
    let four = format!("0 0 0 0 0\n{three}");
    for (body, line, reason) in [
        (format!("{HEADER}{four}3 0 1 4"), 0, "out of range"),
        (format!("{HEADER}{four}3 0 1 -1"), 16, "not a vertex index"),
        (format!("{HEADER}{four}2 0 1"), 16, "3 or more"),
        (format!("{HEADER}{four}-1 0 1"), 16, "length -1"),
        (format!("{HEADER}{four}200 0 1"), 16, "too early"),
        (
            format!("{HEADER}0 0 nan 0 0\n{three}3 0 1 2"),
            12,
            "not a finite number",
        ),
        (format!("{HEADER}0 0 x 0 0\n{three}3 0 1 2"), 12, "not a number"),
        (HEADER.replace("float x", "float q"), 12, "ends before"),
        (
            HEADER.replace("vertex 4", "vertex 0").replace("face 1", "face 0"),
            0,
            "no vertices",
        ),
        (HEADER.replace("float x", "real x"), 4, "unknown type"),
        (HEADER.replace("1.0", "2.0"), 2, "not understood"),
        ("ply\nformat ascii 1.0\nelement vertex 1\n".into(), 4, "end_header"),
        ("obj\n".into(), 1, "starts with"),
        (String::new(), 0, "the file is empty"),
    ] {
        mesh_error(parse(body.as_bytes()), line, reason);
    }
}

#[test]
fn every_broken_number_and_face_is_told() {
    let header = HEADER.replace("face 1", "face 4");
    let text = format!("{header}0 0 x 0 0\n1 nan 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n3 0 1 -1\n2 0 1\n4 0 1 2 9\n3 y 0 1\n");
    let told: Vec<String> = parse(text.as_bytes())
        .unwrap_err()
        .iter()
        .map(ToString::to_string)
        .collect();
    let expected = [
        "mesh:12: `x` is not a number of the property's type",
        "mesh:13: vertex 1: `y` is NaN, not a finite number",
        "mesh:16: face 0: -1 is not a vertex index",
        "mesh:17: face 1 has 2 corners; 3 or more are needed",
        "mesh:19: `y` is not a number of the property's type",
        "mesh: vertex index 9 is out of range: the file has 4 vertices",
    ];
    assert_eq!(told, expected);
}
