use super::*;

/// Lights that have moved are those that are built where they have moved to, to the last bit.
#[test]
fn moved_lights_are_those_built_in_their_new_places() {
    let axis = Vec3::new(0.3, 0.8, -0.5);
    let place = |step: f32| facing(Vec3::new(step, 1.0, -step), axis + Vec3::splat(step), Vec3::ONE);
    let at = |step: f32| {
        let to_world = place(step);
        let shapes = vec![
            patch(Vec3::Y, Vec3::NEG_Y),
            sphere(Vec3::ZERO, 0.5, false).moved(&to_world),
        ];
        let mut lights = vec![
            area_light(0, 2.0),
            area_light(1, 3.0),
            Light::Point {
                position: to_world.point(Vec3::ZERO),
                intensity: gray(4.0),
            },
            Light::Spot {
                to_world,
                intensity: gray(9.0),
                cutoff_angle: 0.9,
                beam_width: 0.4,
                falloff: Falloff::Linear,
                texture: None,
            },
            Light::Directional {
                direction: to_world.matrix().z_axis.truncate().normalize().as_vec3(),
                irradiance: gray(1.0),
            },
            environment(8, 5),
        ];
        if let Some(Light::Environment { to_world: turned, .. }) = lights.last_mut() {
            *turned = to_world;
        }
        let corners = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y].map(|corner| corner + Vec3::Z);
        lights.push(Light::Portal {
            portal: Portal::new(corners).expect("a square is a rectangle"),
            beyond: Box::new(lights[5].clone()),
        });
        let geometry = Geometry::build(shapes);
        (Lights::build(lights, &geometry), geometry)
    };
    let ((before, _), (built, geometry)) = (at(0.0), at(0.7));
    let moved = before.moved(&geometry, (1..7).map(|light| (LightId(light), place(0.7))));
    let mut random = random(1);
    for _ in 0..2_000 {
        let from = square_to_sphere(random.next_2d());
        let (choice, u, v) = (random.next_choice(), random.next_choice_2d(), random.next_choice_2d());
        // The text of a number tells all its bits.
        let all = |lights: &Lights| {
            let direct = lights.sample_direct(&geometry, from, choice, u);
            let emission = lights.sample_emission(&geometry, choice, u, v);
            format!(
                "{direct:?} {emission:?} {:?} {}",
                lights.background(from),
                lights.pdf_background(from)
            )
        };
        assert_eq!(all(&moved), all(&built));
    }
}
