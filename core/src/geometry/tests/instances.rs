//! Instances against copies of the same shapes, and rays that leave curved shapes under uneven maps.

use super::*;

/// A map with a matrix of a few bits: it moves vertices of few bits without rounding.
fn exact_map(columns: [[f64; 3]; 3], offset: [f64; 3]) -> Transform {
    let [x, y, z] = columns.map(|column| DVec3::from(column).extend(0.0));
    Transform::from_matrix(DMat4::from_cols(x, y, z, DVec3::from(offset).extend(1.0))).unwrap()
}

fn exact_maps() -> Vec<Transform> {
    vec![
        exact_map([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 0.0]),
        exact_map([[0.0, 2.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 0.0, 2.0]], [6.0, -1.0, 2.0]),
        // This one mirrors.
        exact_map([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]], [-3.0, 2.5, 0.5]),
        exact_map([[0.0, 0.0, 1.0], [1.0, 0.5, 0.0], [0.0, 1.0, 0.0]], [0.0, -4.0, -3.0]),
    ]
}

/// A torus whose coordinates have 12 bits behind the point, with normals and texture coordinates.
fn rounded_torus() -> TriangleMesh {
    let mut mesh = torus(16);
    for p in &mut mesh.positions {
        *p = (*p * 4096.0).round() / 4096.0;
    }
    mesh.normals = mesh
        .positions
        .iter()
        .map(|p| (*p - Vec3::new(p.x, p.y, 0.0).normalize()).normalize())
        .collect();
    mesh.uvs = mesh.positions.iter().map(|p| Vec2::new(p.x, p.z)).collect();
    mesh
}

fn group_of_three() -> Vec<Shape> {
    let placed = |offset: [f64; 3]| exact_map([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]], offset);
    vec![
        Shape::Mesh(rounded_torus().into()),
        Shape::Ellipsoid {
            to_world: placed([2.0, 0.0, 0.0]),
            flip_normals: false,
        },
        Shape::Cylinder {
            to_world: placed([-2.0, 0.0, 0.5]),
            flip_normals: true,
        },
        Shape::Disk {
            to_world: placed([0.0, 2.0, 0.0]),
            flip_normals: false,
        },
    ]
}

/// The shape under `map`. Outer sides stay, as those of an instance do.
fn copied(shape: &Shape, map: &Transform) -> Shape {
    match (shape.moved(map), map.flips_handedness()) {
        (Shape::Mesh(mesh), true) => {
            let mut mesh = TriangleMesh::clone(&mesh);
            // The order of vertices turns with the map, so that barycentric coordinates stay those of the same vertices.
            mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
            Shape::Mesh(mesh.into())
        }
        (shape, _) => shape,
    }
}

#[test]
fn instances_answer_as_copies_do() {
    let other = Shape::Mesh(cube(|p| p * 0.75 + DVec3::new(0.0, 0.0, -3.0)).into());
    let first = ShapeGroup::build(vec![other.clone()], None);
    let group = Arc::new(ShapeGroup::build(group_of_three(), Some(&first)));
    let maps = exact_maps();
    let mut instanced = vec![other.clone()];
    instanced.extend(maps.iter().map(|map| Shape::Instance {
        group: Arc::clone(&group),
        to_world: *map,
    }));
    let mut copies = vec![other];
    copies.extend(
        maps.iter()
            .flat_map(|map| group_of_three().into_iter().map(|shape| copied(&shape, map))),
    );
    let (instanced, copies) = (Geometry::build(instanced), Geometry::build(copies));
    let mut hits = [0; 4];
    for path in 0..200_000 {
        let mut random = random(path);
        let center = maps[(path % 4) as usize].point(Vec3::ZERO);
        let origin = center + warp::square_to_sphere(random.next_2d()) * 6.0 * random.next_1d();
        let ray = ray(origin, warp::square_to_sphere(random.next_2d()));
        let (found, expected) = (instanced.intersect(&ray), copies.intersect(&ray));
        assert_eq!(found.is_some(), expected.is_some(), "{ray:?}");
        assert_eq!(instanced.occluded(&ray), expected.is_some());
        let (Some(found), Some(expected)) = (found, expected) else {
            continue;
        };
        let close = |a: f32, b: f32| (a - b).abs() <= 2.0 * f32::EPSILON * b.abs().max(1.0);
        assert!(close(found.distance, expected.distance), "{found:?} {expected:?}");
        let error = (found.position - expected.position).abs().max_element();
        assert!(error <= found.position_error, "{found:?} {expected:?}");
        assert!(
            (found.geometric_normal - expected.geometric_normal).length() < 1e-5,
            "{found:?} {expected:?}"
        );
        // An uneven map keeps a mean of normals only where it maps them unnormalised.
        let even = expected.shape.0 <= 2 * 4;
        if even {
            assert!(
                (found.frame.n - expected.frame.n).length() < 1e-5,
                "{found:?} {expected:?}"
            );
            assert!(
                (found.frame.s - expected.frame.s).length() < 1e-3,
                "{found:?} {expected:?}"
            );
        }
        if expected.shape == ShapeId(0) {
            assert_eq!(found.shape, ShapeId(0));
            continue;
        }
        // Five shapes are in the scene, and one in the first group.
        let inner = (expected.shape.0 - 1) % 4;
        assert_eq!(found.shape, ShapeId(5 + 1 + inner));
        assert_eq!(found.primitive, expected.primitive);
        let swapped = inner == 0 && maps[((expected.shape.0 - 1) / 4) as usize].flips_handedness();
        assert!(
            swapped || (found.uv - expected.uv).length() < 1e-4,
            "{found:?} {expected:?}"
        );
        hits[inner as usize] += 1;
        let shorter = Ray {
            max_distance: found.distance * 0.9999,
            ..ray
        };
        assert!(!instanced.occluded(&shorter) && instanced.intersect(&shorter).is_none());
    }
    assert!(hits.iter().all(|hits| *hits > 1_000), "{hits:?}");
}

/// Of instances in one place that of the lowest number is hit, in whichever order the hierarchy has them.
#[test]
fn the_first_of_coincident_instances_is_hit() {
    let groups = [0.0, 1.0].map(|offset| {
        let cube = Shape::Mesh(cube(|p| p + DVec3::splat(offset)).into());
        Arc::new(ShapeGroup::build(vec![cube], None))
    });
    let shift = Transform::from_matrix(DMat4::from_translation(DVec3::splat(-1.0))).unwrap();
    let shapes = (0..20).map(|index| Shape::Instance {
        group: Arc::clone(&groups[index % 2]),
        to_world: [Transform::default(), shift][index % 2],
    });
    let geometry = Geometry::build(shapes.collect());
    for path in 0..1_000 {
        let start = ray(Vec3::ZERO, warp::square_to_sphere(random(path).next_2d()));
        let hit = geometry.hierarchy.nearest(&Line::of(&start), f64::INFINITY).unwrap();
        assert_eq!(hit.primitive, 0);
    }
}

/// The closed convex bodies of [`rays_leave_surfaces_at_every_scale_and_far_from_the_origin`], instanced with maps that scale them unevenly.
#[test]
fn rays_leave_instances_at_every_scale_and_far_from_the_origin() {
    let unit_sphere = Shape::Sphere {
        center: Vec3::ZERO,
        radius: 1.0,
        to_local: Transform::default(),
        flip_normals: false,
    };
    let far_cube = cube(|p| p + DVec3::new(300.0, -50.0, 20.0));
    let bodies = [
        (Shape::Mesh(cube(|p| p).into()), DVec3::ZERO),
        (Shape::Mesh(far_cube.into()), DVec3::new(300.0, -50.0, 20.0)),
        (unit_sphere, DVec3::ZERO),
    ];
    let mut path = 1_000;
    for scale in [1e-3, 1e-1, 1.0, 1e2, 1e5] {
        for far in [0.0, 10.0, 1e3] {
            for (body, body_center) in &bodies {
                path += 1;
                let mut random = random(path);
                let uneven = DVec3::new(1.0, 0.3 + f64::from(random.next_1d()), -2.0);
                let turn = rotation(&mut random) * DMat3::from_diagonal(uneven * scale) * rotation(&mut random);
                let center = warp::square_to_sphere(random.next_2d()).as_dvec3() * scale * far;
                let offset = center - turn * *body_center;
                let map = DMat4::from_translation(offset) * DMat4::from_mat3(turn);
                let to_world = Transform::from_matrix(map).unwrap();
                let group = Arc::new(ShapeGroup::build(vec![body.clone()], None));
                let geometry = Geometry::build(vec![Shape::Instance { group, to_world }]);
                leave_convex_body(&geometry, center.as_vec3(), far < 100.0, &mut random);
            }
        }
    }
}

/// A plane within a group, turned by 90 degrees into one through the world's origin: where coordinates should be zero there are some
/// 1e-17, and the maps there and back differ by as much.
#[test]
fn rays_leave_an_instanced_plane_that_is_all_but_aligned_with_the_axes() {
    let mut plane = cube(|p| DVec3::new(1.6 * p.x, 1.6 * p.y, 0.0));
    plane.triangles.truncate(2);
    let group = Arc::new(ShapeGroup::build(vec![Shape::Mesh(plane.into())], None));
    let turn = DMat4::from_rotation_x(std::f64::consts::FRAC_PI_2);
    for stretch in [1.0, 1e3, 1e-4] {
        let map = turn * DMat4::from_scale(DVec3::new(1.0, 1.0, stretch)) * DMat4::from_rotation_y(0.0);
        let to_world = Transform::from_matrix(map).unwrap();
        let group = Arc::clone(&group);
        let geometry = Geometry::build(vec![Shape::Instance { group, to_world }]);
        for i in 0..20_000 {
            let mut random = random(i);
            let target = Vec3::new(3.0 * random.next_1d() - 1.5, 0.0, 3.0 * random.next_1d() - 1.5);
            let from = Vec3::new(0.3, 2.0, -0.4);
            let point = geometry
                .intersect(&ray(from, (target - from).normalize()))
                .expect("the plane is below");
            let mut direction = warp::square_to_sphere(random.next_2d());
            direction.y = direction.y.abs();
            let leaving = point.ray_towards(direction);
            assert!(geometry.intersect(&leaving).is_none(), "{point:?} along {direction}");
        }
    }
}

#[test]
fn rays_leave_ellipsoids_and_cylinders() {
    let mut path = 2_000;
    for scale in [1e-3, 1.0, 1e5] {
        for far in [0.0, 10.0, 1e3] {
            path += 1;
            let mut random = random(path);
            let center = warp::square_to_sphere(random.next_2d()).as_dvec3() * scale * far;
            let uneven = DMat3::from_diagonal(DVec3::new(1.0, 0.4, 2.0) * scale);
            let turn = rotation(&mut random) * uneven * rotation(&mut random);
            let place = |own: DVec3| {
                let map = DMat4::from_translation(center) * DMat4::from_mat3(turn) * DMat4::from_translation(own);
                Transform::from_matrix(map).unwrap()
            };
            let ellipsoid = Shape::Ellipsoid {
                to_world: place(DVec3::ZERO),
                flip_normals: false,
            };
            leave_convex_body(&Geometry::build(vec![ellipsoid]), center.as_vec3(), true, &mut random);
            let mantle = Shape::Cylinder {
                to_world: place(DVec3::new(0.0, 0.0, -0.5)),
                flip_normals: false,
            };
            let cap = |z: f64, flip_normals: bool| Shape::Disk {
                to_world: place(DVec3::new(0.0, 0.0, z)),
                flip_normals,
            };
            let closed = Geometry::build(vec![mantle, cap(0.5, false), cap(-0.5, true)]);
            for _ in 0..10_000 {
                let start = ray(center.as_vec3(), warp::square_to_sphere(random.next_2d()));
                let point = closed.intersect(&start).expect("a ray from the centre hits");
                assert!(point.geometric_normal.dot(start.direction) > 0.0);
                let local = warp::square_to_cosine_hemisphere(random.next_2d());
                let outwards = Frame::from_normal(point.geometric_normal).to_world(local).normalize();
                assert!(!closed.occluded(&point.ray_towards(outwards)), "{point:?} hits itself");
                assert!(closed.occluded(&point.ray_towards(-outwards)), "{point:?} leaks");
            }
        }
    }
}

/// Points sampled on a cylinder tell the solid angle that rays find.
#[test]
fn a_cylinder_is_sampled_with_its_density() {
    let turn = DMat4::from_rotation_x(0.7) * DMat4::from_rotation_y(0.4);
    let map = DMat4::from_translation(DVec3::new(0.5, 1.0, 2.0)) * turn * DMat4::from_scale(DVec3::new(0.5, 0.5, 1.5));
    let geometry = Geometry::build(vec![Shape::Cylinder {
        to_world: Transform::from_matrix(map).unwrap(),
        flip_normals: false,
    }]);
    let sampler = ShapeSampler::new(&geometry, ShapeId(0));
    assert!((sampler.area() - std::f32::consts::TAU * 0.5 * 1.5).abs() < 1e-5);
    let from = Vec3::new(0.1, -0.3, 0.2);
    let count = 800_000;
    // Of each: the sum and the sum of squares.
    let (mut by_points, mut by_rays) = ([0.0; 2], [0.0; 2]);
    for path in 0..count {
        let mut random = random(path);
        let u = random.next_2d().as_dvec2();
        let sample = sampler.sample_towards(&geometry, from, u).unwrap();
        let hit = geometry.intersect(&ray(from, sample.direction));
        let seen = hit.is_some_and(|hit| (hit.distance - sample.distance).abs() < 1e-3 * sample.distance);
        let value = if seen { 1.0 / f64::from(sample.pdf) } else { 0.0 };
        let again = sampler.pdf_towards(from, &sample.point);
        assert!((again - sample.pdf).abs() < 1e-4 * sample.pdf);
        let missed = geometry
            .intersect(&ray(from, warp::square_to_sphere(random.next_2d())))
            .is_none();
        let of_rays = if missed { 0.0 } else { 4.0 * std::f64::consts::PI };
        for (sums, value) in [(&mut by_points, value), (&mut by_rays, of_rays)] {
            sums[0] += value;
            sums[1] += value * value;
        }
    }
    let statistics = |[sum, squares]: [f64; 2]| {
        let n = count as f64;
        let mean = sum / n;
        (mean, (squares / n - mean * mean) / n)
    };
    let ((a, va), (b, vb)) = (statistics(by_points), statistics(by_rays));
    let z = (a - b).abs() / (va + vb).sqrt();
    assert!(z < 4.0, "{a} by points and {b} by rays: {z} standard errors");
    assert!((va + vb).sqrt() < 0.01 * b);
}

/// Ten thousand instances hold the triangles and the hierarchy of one.
#[test]
fn instances_share_one_group() {
    let group = Arc::new(ShapeGroup::build(vec![Shape::Mesh(torus(40).into())], None));
    let instances = (0..10_000).map(|index| {
        let offset = DVec3::new(f64::from(index % 100), f64::from(index / 100), 0.0) * 3.0;
        Shape::Instance {
            group: Arc::clone(&group),
            to_world: Transform::from_matrix(DMat4::from_translation(offset)).unwrap(),
        }
    });
    let geometry = Geometry::build(instances.collect());
    assert!(geometry.hierarchy.blocks.is_empty());
    assert_eq!(geometry.hierarchy.curved.len(), 10_000);
    // The shape and the leaf of each instance refer to the group, and so does this test.
    assert_eq!(Arc::strong_count(&group), 20_001);
    let down = |x: f32, y: f32| geometry.intersect(&ray(Vec3::new(x, y, 5.0), -Vec3::Z)).unwrap();
    let (near, far) = (down(1.0, 0.1), down(298.0, 297.1));
    assert_eq!(near.primitive, far.primitive);
    assert_eq!((near.shape, far.shape), (ShapeId(10_000), ShapeId(10_000)));
    assert!((far.position - near.position - Vec3::new(297.0, 297.0, 0.0)).length() < 1e-4);
}

/// A moved instance is hit as one that was built where it stands.
#[test]
fn instances_move() {
    let group = Arc::new(ShapeGroup::build(vec![Shape::Mesh(torus(12).into())], None));
    let instance = |to_world| Shape::Instance {
        group: Arc::clone(&group),
        to_world,
    };
    let mut numbers = random(9);
    let places: Vec<Transform> = (0..12).map(|_| placement(&mut numbers)).collect();
    let mut shapes: Vec<Shape> = places.iter().map(|place| instance(*place)).collect();
    let geometry = Geometry::build(shapes.clone());
    let by = placement(&mut numbers);
    let moved = geometry.moved([(ShapeId(3), shapes[3].moved(&by))]);
    shapes[3] = instance(by.after(&places[3]));
    let built = Geometry::build(shapes);
    let mut hits = 0;
    for path in 0..20_000 {
        let mut random = random(path);
        let origin = warp::square_to_sphere(random.next_2d()) * 8.0 * random.next_1d();
        let ray = ray(origin, warp::square_to_sphere(random.next_2d()));
        let (found, expected) = (moved.intersect(&ray), built.intersect(&ray));
        assert_eq!(format!("{found:?}"), format!("{expected:?}"), "{ray:?}");
        hits += usize::from(expected.is_some());
    }
    assert!(hits > 2_000, "{hits}");
}
