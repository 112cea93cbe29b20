//! Scenes in which light reaches the camera by one chain of bounces only.
//!
//! Every chain is laid out unfolded first, as if its plane mirrors were not there: the light shines at a diffuse floor or
//! straight into the camera. Then light and camera are reflected at the planes of the mirrors that stand between them
//! and the rest. Mirrors and floors scatter on one side, so most unwanted paths meet a black back; a black plate blocks the others.

use anyhow::Result;
use photonfarm_core::math::Vec3;
use photonfarm_core::scene::Scene;
use photonfarm_tests::scenes;
use std::collections::BTreeMap;

/// What emits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Emitter {
    Area,
    Point,
    Directional,
    Spot,
    Environment,
}

/// What sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Eye {
    Pinhole,
    ThinLens,
    Orthographic,
}

/// Surfaces between light and camera, in the order of light: D diffuse, S a plane mirror.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Chain {
    D,
    S,
    Ss,
    Sds,
    Dsd,
}

impl Emitter {
    pub(super) const ALL: [Self; 5] = [
        Self::Area,
        Self::Point,
        Self::Directional,
        Self::Spot,
        Self::Environment,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Area => "area",
            Self::Point => "point",
            Self::Directional => "directional",
            Self::Spot => "spot",
            Self::Environment => "environment",
        }
    }

    /// Whether no ray that is sampled by a material or a camera finds it.
    pub(super) fn is_delta(self) -> bool {
        matches!(self, Self::Point | Self::Directional | Self::Spot)
    }
}

impl Eye {
    pub(super) const ALL: [Self; 3] = [Self::Pinhole, Self::ThinLens, Self::Orthographic];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::ThinLens => "thin lens",
            Self::Orthographic => "orthographic",
        }
    }
}

impl Chain {
    pub(super) const ALL: [Self; 5] = [Self::D, Self::S, Self::Ss, Self::Sds, Self::Dsd];

    /// The whole path in the notation of Heckbert, light first.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::D => "L D E",
            Self::S => "L S E",
            Self::Ss => "L S S E",
            Self::Sds => "L S D S E",
            Self::Dsd => "L D S D E",
        }
    }

    /// Edges of the path.
    pub(super) fn edges(self) -> u32 {
        match self {
            Self::D | Self::S => 2,
            Self::Ss => 3,
            Self::Sds | Self::Dsd => 4,
        }
    }

    /// Whether the camera sees the light itself, by mirrors.
    pub(super) fn shows_the_light(self) -> bool {
        matches!(self, Self::S | Self::Ss)
    }
}

/// Albedo of diffuse surfaces.
pub(super) const ALBEDO: f64 = 0.8;

/// Radius of the area light [scene units].
pub(super) const LIGHT_RADIUS: f32 = 0.08;

/// Radius of the thin lens [scene units].
pub(super) const LENS_RADIUS: f32 = 0.03;

/// Height of the horizontal mirror above the floor [scene units], where the chain has one.
pub(super) const fn mirror_height(chain: Chain) -> f32 {
    match chain {
        Chain::Ss => 0.7,
        Chain::Sds => 0.4,
        _ => 0.3,
    }
}

/// The diffuse patch that the light shines at in the chain `D S D`: centre and half its side.
pub(super) const FIRST_PATCH: (Vec3, f32) = (Vec3::new(-0.5, 0.0, 0.0), 0.35);

/// Something that points from `origin` to `target`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aim {
    pub(super) origin: Vec3,
    pub(super) target: Vec3,
}

impl Aim {
    fn new(target: Vec3, direction: Vec3, distance: f32) -> Self {
        let origin = target + distance * direction;
        Self { origin, target }
    }

    pub(super) fn direction(&self) -> Vec3 {
        (self.target - self.origin).normalize()
    }

    pub(super) fn distance(&self) -> f32 {
        (self.target - self.origin).length()
    }

    /// Reflected at the plane `y = height`.
    fn mirrored(self, height: f32) -> Self {
        let mirror = |p: Vec3| Vec3::new(p.x, 2.0 * height - p.y, p.z);
        Self {
            origin: mirror(self.origin),
            target: mirror(self.target),
        }
    }
}

/// A unit vector in the plane z = 0 (or x = 0), `degrees` from +y towards +x (or +z).
fn tilted(degrees: f32, towards_z: bool) -> Vec3 {
    let (sin, cos) = degrees.to_radians().sin_cos();
    if towards_z {
        Vec3::new(0.0, cos, sin)
    } else {
        Vec3::new(sin, cos, 0.0)
    }
}

/// One cell's scene.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub(super) emitter: Emitter,
    pub(super) eye: Eye,
    pub(super) chain: Chain,
}

impl Layout {
    /// Where the light is, unfolded.
    pub(super) fn light(&self) -> Aim {
        match self.chain {
            Chain::D | Chain::Sds => Aim::new(Vec3::ZERO, tilted(-50.0, false), 1.45),
            Chain::Dsd => {
                // From further away less of the area light looks under the plate.
                let distance = if self.emitter == Emitter::Area { 1.6 } else { 1.0 };
                Aim::new(FIRST_PATCH.0, tilted(-60.0, false), distance)
            }
            Chain::S | Chain::Ss => Aim::new(Vec3::ZERO, tilted(-35.0, false), 0.9).mirrored(0.0),
        }
    }

    /// Where the mirrors put the light.
    pub(super) fn placed_light(&self) -> Aim {
        match self.chain {
            Chain::D | Chain::Dsd => self.light(),
            Chain::S | Chain::Ss => self.light().mirrored(0.0),
            Chain::Sds => self.light().mirrored(mirror_height(self.chain)),
        }
    }

    /// Where the camera is, unfolded.
    pub(super) fn camera(&self) -> Aim {
        match self.chain {
            Chain::D | Chain::Sds => Aim::new(Vec3::ZERO, tilted(45.0, true), 1.3),
            Chain::Dsd => Aim::new(Vec3::new(0.5, 0.0, 0.0), tilted(45.0, false), 1.3),
            Chain::S => Aim::new(Vec3::ZERO, tilted(35.0, false), 1.0),
            Chain::Ss => Aim::new(Vec3::ZERO, tilted(35.0, false), 1.6),
        }
    }

    /// Half the side of the square that the image shows about the point aimed at, at right angles to the view [scene units].
    pub(super) fn half_width(&self) -> f32 {
        if self.chain.shows_the_light() { 0.34 } else { 0.13 }
    }

    /// The scene, with mirrors, and light and camera where the mirrors put them.
    pub(super) fn scene(&self) -> Result<Scene> {
        let height = mirror_height(self.chain);
        let (light, camera) = (self.placed_light(), self.camera());
        let camera = match self.chain {
            Chain::D | Chain::Dsd | Chain::S => camera,
            Chain::Ss | Chain::Sds => camera.mirrored(height),
        };
        load(&format!(
            "{}{}{}",
            self.sensor_xml(camera),
            self.emitter_xml(light),
            self.surfaces_xml()
        ))
    }

    /// A scene whose camera is the unfolded one; its surfaces mean nothing.
    pub(super) fn unfolded(&self) -> Result<Scene> {
        let surfaces = horizontal("diffuse", Vec3::ZERO, [1.0, 1.0], true);
        load(&format!(
            "{}{}{surfaces}",
            self.sensor_xml(self.camera()),
            self.emitter_xml(self.light())
        ))
    }

    fn sensor_xml(&self, camera: Aim) -> String {
        let half = self.half_width();
        let (plugin, properties, scale) = match self.eye {
            Eye::Pinhole => ("perspective", String::new(), String::new()),
            Eye::ThinLens => (
                "thinlens",
                format!(
                    r#"<float name="aperture_radius" value="{LENS_RADIUS}"/><float name="focus_distance" value="{}"/>"#,
                    camera.distance()
                ),
                String::new(),
            ),
            Eye::Orthographic => (
                "orthographic",
                String::new(),
                format!(r#"<scale x="{half}" y="{half}" z="1"/>"#),
            ),
        };
        let fov = match self.eye {
            Eye::Orthographic => String::new(),
            _ => format!(
                r#"<float name="fov" value="{}"/>"#,
                2.0 * (half / camera.distance()).atan().to_degrees()
            ),
        };
        let up = if camera.direction().x.abs() > 1e-3 {
            "0, 0, 1"
        } else {
            "1, 0, 0"
        };
        format!(
            r#"<sensor type="{plugin}">{fov}{properties}
                <transform name="to_world">{scale}<lookat origin="{}" target="{}" up="{up}"/></transform>
                <film type="hdrfilm">
                    <integer name="width" value="16"/><integer name="height" value="16"/><rfilter type="box"/>
                </film>
            </sensor>
            "#,
            triple(camera.origin),
            triple(camera.target)
        )
    }

    fn emitter_xml(&self, light: Aim) -> String {
        let lookat = format!(
            r#"<lookat origin="{}" target="{}" up="0, 0, 1"/>"#,
            triple(light.origin),
            triple(light.target)
        );
        match self.emitter {
            Emitter::Area => format!(
                r#"<shape type="disk">
                    <transform name="to_world"><scale value="{LIGHT_RADIUS}"/>{lookat}</transform>
                    <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
                    <emitter type="area"><rgb name="radiance" value="1"/></emitter>
                </shape>
                "#
            ),
            Emitter::Point => format!(
                r#"<emitter type="point">
                    <point name="position" value="{}"/><rgb name="intensity" value="1"/>
                </emitter>
                "#,
                triple(light.origin)
            ),
            Emitter::Spot => format!(
                r#"<emitter type="spot">
                    <transform name="to_world">{lookat}</transform>
                    <rgb name="intensity" value="1"/>
                    <float name="beam_width" value="30"/><float name="cutoff_angle" value="32"/>
                </emitter>
                "#
            ),
            Emitter::Directional => format!(
                r#"<emitter type="directional">
                    <vector name="direction" value="{}"/><rgb name="irradiance" value="1"/>
                </emitter>
                "#,
                triple(light.direction())
            ),
            Emitter::Environment => {
                let axis = -light.direction();
                format!(
                    r#"<emitter type="envmap">
                        <string name="filename" value="cap.png"/>
                        <transform name="to_world"><rotate z="1" angle="{}"/></transform>
                    </emitter>
                    "#,
                    (-axis.x).atan2(axis.y).to_degrees()
                )
            }
        }
    }

    fn surfaces_xml(&self) -> String {
        let height = mirror_height(self.chain);
        let above = |x: f32| Vec3::new(x, height, 0.0);
        match self.chain {
            Chain::D => horizontal("floor", Vec3::ZERO, [0.45, 0.45], true),
            Chain::S => horizontal("mirror", Vec3::ZERO, [0.6, 0.6], true),
            Chain::Ss => {
                horizontal("mirror", Vec3::ZERO, [0.6, 0.6], true)
                    + &horizontal("mirror", above(0.49), [0.5, 0.5], false)
            }
            Chain::Sds => {
                horizontal("floor", Vec3::ZERO, [0.45, 0.45], true)
                    + &horizontal("mirror", above(0.0), [1.2, 1.2], false)
            }
            Chain::Dsd => {
                let side = FIRST_PATCH.1;
                // Shades the second patch from the light, and the first one hardly.
                let left = match self.emitter {
                    Emitter::Directional | Emitter::Environment => -0.52,
                    Emitter::Area => -0.72,
                    Emitter::Point | Emitter::Spot => -0.83,
                };
                let (from, to) = (left, -0.38_f32);
                let plate = above(0.5 * (from + to)) + Vec3::new(0.0, 0.01, 0.0);
                horizontal("floor", FIRST_PATCH.0, [side, side], true)
                    + &horizontal("floor", -FIRST_PATCH.0, [side, 0.4], true)
                    + &horizontal("mirror", above(0.0), [0.4, 0.6], false)
                    + &horizontal("black", plate, [0.5 * (to - from), 0.6], false)
            }
        }
    }
}

/// A rectangle in the plane y = `centre.y`, of half the sides `half` in x and z.
fn horizontal(material: &str, centre: Vec3, half: [f32; 2], faces_up: bool) -> String {
    let angle = if faces_up { -90 } else { 90 };
    let bsdf = match material {
        "mirror" => r#"<bsdf type="conductor"/>"#.to_owned(),
        "black" => r#"<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>"#.to_owned(),
        _ => format!(r#"<bsdf type="diffuse"><rgb name="reflectance" value="{ALBEDO}"/></bsdf>"#),
    };
    format!(
        r#"<shape type="rectangle">
            <transform name="to_world">
                <scale x="{}" y="{}" z="1"/><rotate x="1" angle="{angle}"/><translate value="{}"/>
            </transform>
            {bsdf}
        </shape>
        "#,
        half[0],
        half[1],
        triple(centre)
    )
}

fn triple(v: Vec3) -> String {
    format!("{}, {}, {}", v.x, v.y, v.z)
}

/// Rows of the environment's image: 2 degrees apart.
pub(super) const CAP_ROWS: u32 = 91;

/// Rows at the pole that are white: radiance is 1 up to 2 degrees from the axis and falls in proportion to the angle to 0 at 4 degrees.
const WHITE_ROWS: u32 = 2;

/// Radiance of the environment at `angle` from its axis \[radians\].
pub(super) fn cap_radiance(angle: f64) -> f64 {
    let row = angle.to_degrees() / (180.0 / f64::from(CAP_ROWS - 1));
    (f64::from(WHITE_ROWS) - row).clamp(0.0, 1.0)
}

fn load(objects: &str) -> Result<Scene> {
    let mut image = image::GrayImage::new(8, CAP_ROWS);
    for (_, row, pixel) in image.enumerate_pixels_mut() {
        pixel.0 = [if row < WHITE_ROWS { 255 } else { 0 }];
    }
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png)?;
    let xml = format!("<scene version=\"3.0.0\">\n{objects}</scene>");
    let files = BTreeMap::from([
        ("scene.xml".to_owned(), xml.into_bytes()),
        ("cap.png".to_owned(), png.into_inner()),
    ]);
    scenes::load(&files, "scene.xml", &[])
}
