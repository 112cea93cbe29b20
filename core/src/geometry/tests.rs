//! Tests of the ray queries. Counts are exact: every ray must answer rightly, so there is no false alarm.

mod instances;

use super::*;
use crate::math::{DVec3, sin_cos, warp};
use crate::random::{PathRandom, Stream};
use glam::{DMat3, DMat4};

fn random(path: u64) -> PathRandom {
    PathRandom::new(17, 1, Stream::Camera, path)
}

fn rotation(random: &mut PathRandom) -> DMat3 {
    let n = warp::square_to_sphere(random.next_2d());
    let frame = Frame::from_normal(n);
    DMat3::from_cols(frame.s.as_dvec3(), frame.t.as_dvec3(), frame.n.as_dvec3())
}

/// A closed torus of `2 * rings * rings` triangles, bumpy so that no two are alike.
fn torus(rings: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for i in 0..rings {
        for j in 0..rings {
            let bump = 1.0 + 0.05 * random(u64::from(i * rings + j)).next_1d();
            let (sin_u, cos_u) = sin_cos(std::f32::consts::TAU * i as f32 / rings as f32);
            let (sin_v, cos_v) = sin_cos(std::f32::consts::TAU * j as f32 / rings as f32);
            let radius = 1.0 + 0.4 * bump * cos_v;
            mesh.positions
                .push(Vec3::new(radius * cos_u, radius * sin_u, 0.4 * bump * sin_v));
            let at = |i: u32, j: u32| (i % rings) * rings + j % rings;
            mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    mesh
}

/// A closed cube of edge 2 about the origin, mapped by `map`.
fn cube(map: impl Fn(DVec3) -> DVec3) -> TriangleMesh {
    let corner = |i: u32| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 2.0 - 1.0;
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    TriangleMesh {
        positions: (0..8).map(|i| map(corner(i)).as_vec3()).collect(),
        triangles: faces
            .iter()
            .flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]])
            .collect(),
        ..TriangleMesh::default()
    }
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray {
        origin,
        direction,
        max_distance: f32::INFINITY,
    }
}

/// Nearest hit by the plain method of Moeller and Trumbore over all triangles, in double precision.
fn brute_force(mesh: &TriangleMesh, ray: &Ray) -> Option<(f64, usize)> {
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let distance = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|i| mesh.positions[i as usize].as_dvec3());
        let (e1, e2, from) = (b - a, c - a, origin - a);
        let p = direction.cross(e2);
        let determinant = e1.dot(p);
        let (u, q) = (from.dot(p) / determinant, from.cross(e1));
        let v = direction.dot(q) / determinant;
        let t = e2.dot(q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
    };
    let hits = mesh
        .triangles
        .iter()
        .enumerate()
        .filter_map(|(i, triangle)| Some((distance(triangle)?, i)));
    hits.min_by(|a, b| a.0.total_cmp(&b.0))
}

#[test]
fn the_nearest_hit_is_that_of_an_exhaustive_search() {
    let mesh = torus(24);
    let geometry = Geometry::build(vec![Shape::Mesh(mesh.clone().into())]);
    let mut hits = 0;
    for path in 0..20_000 {
        let mut random = random(path);
        let origin = warp::square_to_sphere(random.next_2d()) * 2.0 * random.next_1d();
        let ray = ray(origin, warp::square_to_sphere(random.next_2d()));
        let expected = brute_force(&mesh, &ray);
        let found = geometry.intersect(&ray);
        assert_eq!(geometry.occluded(&ray), expected.is_some());
        assert_eq!(found.map(|f| f.primitive as usize), expected.map(|e| e.1));
        if let (Some(found), Some((t, _))) = (found, expected) {
            hits += 1;
            assert!((f64::from(found.distance) - t).abs() < 1e-6);
            assert!((ray.origin + ray.direction * found.distance - found.position).length() < 1e-6);
            let shorter = Ray {
                max_distance: found.distance * 0.999,
                ..ray
            };
            assert!(!geometry.occluded(&shorter) && geometry.intersect(&shorter).is_none());
        }
    }
    assert!(hits > 5_000);
}

#[test]
fn no_ray_leaks_out_of_a_closed_mesh() {
    let mesh = torus(40);
    let geometry = Geometry::build(vec![Shape::Mesh(mesh.clone().into())]);
    for path in 0..1_000_000 {
        let mut random = random(path);
        let (sin_u, cos_u) = sin_cos(std::f32::consts::TAU * random.next_1d());
        let inside = Vec3::new(cos_u, sin_u, 0.0) + 0.3 * random.next_1d() * warp::square_to_sphere(random.next_2d());
        let direction = match path % 3 {
            0 => warp::square_to_sphere(random.next_2d()),
            aim => {
                let corner = |random: &mut PathRandom| {
                    let triangle = mesh.triangles[(random.next_1d() * mesh.triangles.len() as f32) as usize];
                    [
                        mesh.positions[triangle[0] as usize],
                        mesh.positions[triangle[1] as usize],
                    ]
                };
                let [a, b] = corner(&mut random);
                (if aim == 1 { a } else { a.lerp(b, random.next_1d()) } - inside).normalize()
            }
        };
        assert!(geometry.occluded(&ray(inside, direction)), "{inside} {direction}");
    }
}

/// Rays exactly through the diagonals and corners of a box, where an edge function is zero.
#[test]
fn edges_and_vertices_belong_to_a_triangle() {
    let geometry = Geometry::build(vec![Shape::Mesh(cube(|p| p).into())]);
    for step in -8..=8 {
        let at = step as f32 / 8.0;
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            let (a, b) = (
                Vec3::new(axis.y, axis.z, axis.x) * at,
                Vec3::new(axis.z, axis.x, axis.y) * at,
            );
            for (origin, direction) in [a + b, a - b]
                .into_iter()
                .flat_map(|origin| [(origin, axis), (origin, -axis)])
            {
                assert!(geometry.occluded(&ray(origin, direction)), "{origin} {direction}");
            }
        }
    }
}

/// Leaves the surface of convex bodies: outwards nothing may be hit, inwards the other side must be.
#[test]
fn rays_leave_surfaces_at_every_scale_and_far_from_the_origin() {
    let mut path = 0;
    for scale in [1e-3, 1e-1, 1.0, 1e2, 1e5] {
        for far in [0.0, 10.0, 1e3] {
            path += 1;
            let mut random = random(path);
            let turn = rotation(&mut random);
            let center = warp::square_to_sphere(random.next_2d()).as_dvec3() * scale * far;
            let sphere = Shape::Sphere {
                center: center.as_vec3(),
                radius: scale as f32,
                to_local: Transform::from_matrix(
                    DMat4::from_translation(center) * DMat4::from_scale(DVec3::splat(scale)),
                )
                .unwrap()
                .inverted(),
                flip_normals: false,
            };
            let cube = Shape::Mesh(cube(|p| turn * p * scale + center).into());
            for shape in [cube, sphere] {
                leave_convex_body(&Geometry::build(vec![shape]), center.as_vec3(), true, &mut random);
            }
        }
    }
}

/// `inwards`: whether rays inwards are tested, too. Where a sharp edge is no wider than the rounding of positions, they may start outside.
fn leave_convex_body(geometry: &Geometry, center: Vec3, inwards: bool, random: &mut PathRandom) {
    for _ in 0..10_000 {
        let start = ray(center, warp::square_to_sphere(random.next_2d()));
        let point = geometry.intersect(&start).expect("a ray from the centre hits");
        assert!(point.geometric_normal.dot(start.direction) > 0.0);
        let local = warp::square_to_cosine_hemisphere(random.next_2d());
        let grazing = Vec3::new(local.x, local.y, 1e-3 * local.z).normalize();
        for direction in [local, grazing] {
            let direction = Frame::from_normal(point.geometric_normal)
                .to_world(direction)
                .normalize();
            let outwards = point.ray_towards(direction);
            assert!(!geometry.occluded(&outwards), "{:?} {point:?} hits itself", outwards);
            assert!(
                !inwards || geometry.occluded(&point.ray_towards(-direction)),
                "{point:?} leaks along {}",
                -direction
            );
        }
    }
}

/// A rotation by 90 degrees leaves coordinates of some 1e-17 where there should be zeros: a plane through the origin
/// is then known to that precision along its normal, but not the rays that leave it.
#[test]
fn rays_leave_a_plane_that_is_all_but_aligned_with_the_axes() {
    let tilt = 1.6 * 6.123_234e-17;
    let corner = |x: f32, z: f32| Vec3::new(1.6 * x, tilt * z, 1.6 * z);
    let mesh = TriangleMesh {
        positions: vec![
            corner(-1.0, 1.0),
            corner(1.0, 1.0),
            corner(1.0, -1.0),
            corner(-1.0, -1.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    };
    let geometry = Geometry::build(vec![Shape::Mesh(mesh.into())]);
    for i in 0..20_000 {
        let mut random = random(i);
        let target = Vec3::new(3.0 * random.next_1d() - 1.5, 0.0, 3.0 * random.next_1d() - 1.5);
        let from = Vec3::new(0.3, 2.0, -0.4);
        let point = geometry
            .intersect(&ray(from, (target - from).normalize()))
            .expect("the plane is below");
        let mut direction = warp::square_to_sphere(random.next_2d());
        direction.y = direction.y.abs();
        assert!(
            geometry.intersect(&point.ray_towards(direction)).is_none(),
            "{point:?} along {direction}"
        );
    }
}

#[test]
fn paths_never_leave_a_closed_room_through_its_edges_or_corners() {
    for path in 0..200 {
        let mut random = random(path);
        let turn = rotation(&mut random);
        let room = cube(|p| turn * p * 3.0 + DVec3::new(0.7, -0.3, 20.0));
        let geometry = Geometry::build(vec![Shape::Mesh(room.into())]);
        let mut next = ray(Vec3::new(0.7, -0.3, 20.0), warp::square_to_sphere(random.next_2d()));
        for _ in 0..1_000 {
            let point = geometry.intersect(&next).expect("the room is closed");
            let frame = Frame::from_normal(-point.geometric_normal);
            next = point.ray_towards(
                frame
                    .to_world(warp::square_to_cosine_hemisphere(random.next_2d()))
                    .normalize(),
            );
        }
    }
}

#[test]
fn shadow_rays_end_before_the_light_and_see_what_is_between() {
    for (path, scale) in [1e-3_f32, 1.0, 1e4].into_iter().enumerate() {
        let mut random = random(path as u64);
        let turn = rotation(&mut random);
        let quad = |z: f64, size: f64| {
            let map = |p: DVec3| turn * (DVec3::new(p.x * size, p.y * size, z) * f64::from(scale));
            let mut mesh = cube(map);
            mesh.triangles.truncate(2);
            Shape::Mesh(mesh.into())
        };
        let open = Geometry::build(vec![quad(0.0, 5.0), quad(2.0, 1.0)]);
        let blocked = Geometry::build(vec![quad(0.0, 5.0), quad(2.0, 1.0), quad(1.99, 1.1)]);
        let from = |x: f64, y: f64, z: f64| (turn * (DVec3::new(x, y, z) * f64::from(scale))).as_vec3();
        for _ in 0..20_000 {
            let u = random.next_2d().as_dvec2() * 2.0 - 1.0;
            let v = random.next_2d().as_dvec2() * 2.0 - 1.0;
            let above = from(u.x * 4.0, u.y * 4.0, 0.5);
            let down = ray(above, (from(u.x * 4.0, u.y * 4.0, 0.0) - above).normalize());
            let floor = open.intersect(&down).expect("the floor lies below");
            let to_light = from(v.x, v.y, 2.0) - floor.position;
            let shadow = floor.shadow_ray(to_light.normalize(), to_light.length());
            assert!(!open.occluded(&shadow));
            assert!(blocked.occluded(&shadow));
        }
    }
}

#[test]
fn the_lowest_primitive_wins_a_tie() {
    let quad = cube(|p| p);
    let mut reversed = quad.clone();
    reversed.triangles.reverse();
    let copies = (0..18).map(|i| Shape::Mesh(if i % 2 == 0 { quad.clone() } else { reversed.clone() }.into()));
    let geometry = Geometry::build(copies.collect());
    for path in 0..1_000 {
        let mut random = random(path);
        let point = geometry
            .intersect(&ray(Vec3::ZERO, warp::square_to_sphere(random.next_2d())))
            .unwrap();
        assert_eq!(point.shape, ShapeId(0));
        assert!(point.primitive < 12);
    }
}

#[test]
fn spheres_and_disks_have_their_texture_coordinates_and_sides() {
    let sphere = |flip_normals| Shape::Sphere {
        center: Vec3::new(1.0, 2.0, 3.0),
        radius: 2.0,
        to_local: Transform::from_matrix(
            DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)) * DMat4::from_scale(DVec3::splat(2.0)),
        )
        .unwrap()
        .inverted(),
        flip_normals,
    };
    let toward = ray(Vec3::new(1.0, 9.0, 3.0), -Vec3::Y);
    let point = Geometry::build(vec![sphere(false)]).intersect(&toward).unwrap();
    assert_eq!(point.geometric_normal, Vec3::Y);
    assert!((point.uv - Vec2::new(0.25, 0.5)).length() < 1e-6);
    assert!(
        (point.frame.s + Vec3::X).length() < 1e-6,
        "the longitude grows towards -x there"
    );
    assert_eq!(point.distance, 5.0);
    let point = Geometry::build(vec![sphere(true)]).intersect(&toward).unwrap();
    assert_eq!(point.geometric_normal, -Vec3::Y);

    let to_world = Transform::from_matrix(
        DMat4::from_translation(DVec3::new(0.0, 0.0, 1.0)) * DMat4::from_scale(DVec3::new(2.0, 4.0, 1.0)),
    )
    .unwrap();
    let geometry = Geometry::build(vec![Shape::Disk {
        to_world,
        flip_normals: false,
    }]);
    let point = geometry.intersect(&ray(Vec3::new(0.0, 2.0, -4.0), Vec3::Z)).unwrap();
    assert_eq!((point.geometric_normal, point.distance), (Vec3::Z, 5.0));
    assert!((point.uv - Vec2::new(0.5, 0.25)).length() < 1e-6);
    assert!(geometry.intersect(&ray(Vec3::new(2.1, 0.0, -4.0), Vec3::Z)).is_none());
    assert!(geometry.intersect(&ray(Vec3::new(0.0, 4.1, -4.0), Vec3::Z)).is_none());
    assert_eq!(geometry.bounds().1, Vec3::new(2.0, 4.0, 1.0).map(f32::next_up));
}

#[test]
fn vertex_normals_decide_the_outer_side_and_the_frame() {
    let slanted = Vec3::new(0.6, 0.0, -0.8);
    let mesh = TriangleMesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
        normals: vec![slanted; 3],
        uvs: vec![Vec2::ZERO, Vec2::Y, Vec2::X],
        triangles: vec![[0, 1, 2]],
    };
    let geometry = Geometry::build(vec![Shape::Mesh(mesh.into())]);
    let point = geometry.intersect(&ray(Vec3::new(0.25, 0.5, 2.0), -Vec3::Z)).unwrap();
    assert_eq!(point.geometric_normal, -Vec3::Z);
    assert!((point.frame.n - slanted).length() < 1e-6);
    assert!((point.frame.s - Vec3::Y).length() < 1e-6, "u grows along y");
    assert!((point.uv - Vec2::new(0.5, 0.25)).length() < 1e-6);
}

#[test]
fn nothing_and_degenerate_triangles_are_never_hit() {
    let line = TriangleMesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::Y],
        triangles: vec![[0, 1, 2], [0, 0, 1], [0, 1, 3]],
        ..TriangleMesh::default()
    };
    let geometry = Geometry::build(vec![Shape::Mesh(line.into())]);
    let point = geometry.intersect(&ray(Vec3::new(0.25, 0.25, 1.0), -Vec3::Z)).unwrap();
    assert_eq!(point.primitive, 2);
    assert!(!geometry.occluded(&ray(Vec3::new(1.5, 0.0, 1.0), -Vec3::Z)));
    let empty = Geometry::build(Vec::new());
    assert!(!empty.occluded(&ray(Vec3::ZERO, Vec3::X)) && empty.intersect(&ray(Vec3::ZERO, Vec3::X)).is_none());
    assert_eq!(empty.bounds(), (Vec3::ZERO, Vec3::ZERO));
}

#[test]
fn coordinates_of_any_size_neither_stop_nor_break_the_build() {
    for scale in [1e-30_f32, 1e18, 1e30, 3e38, f32::INFINITY, f32::NAN] {
        let mut mesh = torus(12);
        mesh.positions.iter_mut().for_each(|p| *p *= 0.5 * scale);
        mesh.positions[7] = Vec3::splat(scale);
        let geometry = Geometry::build(vec![Shape::Mesh(mesh.into())]);
        for path in 0..100 {
            let mut random = random(path);
            let ray = ray(Vec3::ZERO, warp::square_to_sphere(random.next_2d()));
            assert_eq!(geometry.intersect(&ray).is_some(), geometry.occluded(&ray));
        }
    }
}

/// Large triangles in a small space: almost every box overlaps every other.
#[test]
fn overlapping_triangles_are_searched_exhaustively() {
    let mut mesh = TriangleMesh::default();
    for i in 0..5_000_u32 {
        let mut random = random(u64::from(i));
        mesh.positions
            .extend((0..3).map(|_| warp::square_to_sphere(random.next_2d())));
        mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    let geometry = Geometry::build(vec![Shape::Mesh(mesh.clone().into())]);
    for path in 0..200 {
        let mut random = random(path + 100_000);
        let origin = warp::square_to_sphere(random.next_2d()) * 1.5;
        let ray = ray(origin, warp::square_to_sphere(random.next_2d()));
        let found = geometry.intersect(&ray).map(|point| point.primitive as usize);
        assert_eq!(found, brute_force(&mesh, &ray).map(|hit| hit.1));
    }
}

/// A turn, an even scale and a translation.
fn placement(random: &mut PathRandom) -> Transform {
    let scale = 0.3 + f64::from(random.next_1d());
    let center = warp::square_to_sphere(random.next_2d()) * 5.0 * random.next_1d();
    let turned = DMat4::from_mat3(rotation(random) * scale);
    Transform::from_matrix(DMat4::from_translation(center.as_dvec3()) * turned).unwrap()
}

/// Twelve of 24 shapes move about, two of them together, so that all hits on the second tie with those on the first. The hierarchy that
/// was fitted to all earlier times answers every ray as one that is built for the shapes as they stand, to the last bit.
#[test]
fn hits_do_not_depend_on_the_times_that_a_hierarchy_was_fitted_to() {
    let own: Vec<Shape> = (0..24)
        .map(|index| match index % 4 {
            0 => Shape::Disk {
                to_world: Transform::default(),
                flip_normals: false,
            },
            1 => Shape::Sphere {
                center: Vec3::X,
                radius: 0.8,
                to_local: Transform::default(),
                flip_normals: false,
            },
            _ => Shape::Mesh(torus(8).into()),
        })
        .collect();
    let (first, second) = (18, 22);
    let mut numbers = random(1);
    let mut shapes: Vec<Shape> = own.iter().map(|shape| shape.moved(&placement(&mut numbers))).collect();
    let mut geometry = Geometry::build(shapes.clone());
    let (mut hits, mut ties) = (0, 0);
    for time in 0..4 {
        for index in (0..own.len()).step_by(2) {
            shapes[index] = own[index].moved(&placement(&mut numbers));
        }
        shapes[second] = shapes[first].clone();
        let moved = (0..own.len())
            .step_by(2)
            .map(|index| (ShapeId(index as u32), shapes[index].clone()));
        geometry = geometry.moved(moved);
        let built = Geometry::build(shapes.clone());
        assert_eq!(geometry.bounds(), built.bounds());
        for path in 0..20_000 {
            let mut random = random(time << 32 | path);
            let origin = warp::square_to_sphere(random.next_2d()) * 8.0 * random.next_1d();
            let Shape::Mesh(mesh) = &shapes[2 + 4 * (path % 6) as usize] else {
                unreachable!("every fourth shape from the third on is a torus")
            };
            let triangle = mesh.triangles[(random.next_1d() * mesh.triangles.len() as f32) as usize];
            let [a, b] = [triangle[0], triangle[1]].map(|vertex| mesh.positions[vertex as usize]);
            let direction = match path % 3 {
                0 => warp::square_to_sphere(random.next_2d()),
                1 => (a - origin).normalize(),
                _ => (a.lerp(b, random.next_1d()) - origin).normalize(),
            };
            let ray = ray(origin, direction);
            let (found, expected) = (geometry.intersect(&ray), built.intersect(&ray));
            // The text of a number tells all its bits.
            assert_eq!(format!("{found:?}"), format!("{expected:?}"), "{ray:?}");
            assert_eq!(geometry.occluded(&ray), expected.is_some());
            hits += usize::from(expected.is_some());
            ties += usize::from(expected.is_some_and(|hit| hit.shape == ShapeId(first as u32)));
            assert!(expected.is_none_or(|hit| hit.shape != ShapeId(second as u32)));
        }
    }
    assert!(hits > 20_000 && ties > 500, "{hits} hits, {ties} ties");
}
