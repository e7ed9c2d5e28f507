//! `robot.toml`: a robot of half-spheres and hinges as data, for the body simulator and the search.
//!
//! ```toml
//! format = 1
//! name = "one module"
//! cube_m = 0.11            # edge of a cube
//! ball_radius_m = 0.062    # ball that a half-sphere is cut from
//!
//! self_collision = "unchecked"  # you know that nothing checks whether its parts meet; only the meta-module's moves are checked, and of one
//!                          # module nothing can meet. Any other real robot does not run without this line
//!
//! [bus]                    # what drives the real one; `rb-host bus scan` proposes it, `rb-host bus use` tells the robot
//! driver = "xl330"         # packed (ours), xl330, xc330, xm430, sts or scs; all drivers of a robot are of one kind
//!
//! [[body]]                 # body 0 is the base; parents stand before their children
//!
//! [[body]]
//! parent = 0
//! offset_m = [0.055, 0, 0] # from the parent's origin to this one's at home; the hinge goes through this origin
//! axis = [1, 1, 1]         # direction about which this body turns against its parent when the angle grows
//! joint = 0                # index in gaits and recordings
//! no_load_speed_rad_s = 2.786  # of the real joint, as the firmware checks it; absent: that of the motor
//! motor = "intra"          # which motor of the model: "intra", "inter", or "connector": none, a connection that may give
//!
//! [[half]]                 # their order is that of the masses
//! body = 0
//! centre_m = [0.055, 0, 0] # the cube's centre in the body's frame
//! faces = [[-1, 0, 0], [0, -1, 0], [0, 0, -1]]  # outward normals of the faces; their sum points to the half's middle
//! mass_kg = 0.325          # absent: the model's mass of the half-sphere with this index (from 0, modulo 8)
//!
//! [[cube]]
//! halves = [0, 1]
//!
//! [[pair]]                 # cubes that may meet
//! cubes = [0, 3]
//! ```
//!
//! At home all body frames are parallel to the world. Whether the numbers make a robot is for whoever simulates it to say; this module
//! holds them to their ranges and remembers their lines.

mod machine;

pub use machine::NoMachine;

use crate::model::Key;
use protocol::bus::Profile;
use serde::Deserialize;
use toml::Spanned;

/// Version of the file format.
pub const FORMAT: i64 = 1;
/// Offsets and centres lie within this of their origin, m: far above a robot of a dozen modules, low enough to catch millimetres.
pub(crate) const LENGTH_LIMIT_M: f64 = 10.0;
/// Masses of one half-sphere, kg, as the model's.
pub(crate) const MASS_KG: (f64, f64) = (0.01, 10.0);
/// No-load speeds of a joint, rad/s, as the firmware takes them.
pub(crate) const SPEED_RAD_S: (f64, f64) = (0.01, 20.0);
/// A direction of this squared length or more has one, and one this near to unit length is taken as it stands, to the bit.
const UNIT_TOLERANCE: f64 = 1e-9;

/// Which motor drives a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Motor {
    /// That between the halves of a cube.
    Intra,
    /// That between two cubes.
    Inter,
    /// None: a direction in which a connection gives.
    Connector,
}

/// How a body hangs on its parent.
#[derive(Clone, Debug, PartialEq)]
pub struct Hinge {
    /// Index of the parent.
    pub parent: usize,
    /// From the parent's origin to this body's at home, m.
    pub offset_m: [f64; 3],
    /// Unit axis.
    pub axis: [f64; 3],
    /// Joint index.
    pub joint: usize,
    /// Motor of the joint.
    pub motor: Motor,
    /// No-load speed of the real joint, rad/s; `None` = the motor's.
    pub no_load_speed_rad_s: Option<f64>,
}

/// One half-sphere.
#[derive(Clone, Debug, PartialEq)]
pub struct Half {
    /// Body it belongs to.
    pub body: usize,
    /// From the body's origin to the cube's centre, m.
    pub centre_m: [f64; 3],
    /// Unit outward normals of its three faces.
    pub faces: [[f64; 3]; 3],
    /// Its mass, kg; `None` = the model's.
    pub mass_kg: Option<f64>,
}

/// A part of the file, for messages about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The numbers at the top.
    Top,
    /// A `[[body]]`, from 0.
    Body(usize),
    /// A `[[half]]`, from 0.
    Half(usize),
    /// A `[[cube]]`, from 0.
    Cube(usize),
    /// A `[[pair]]`, from 0.
    Pair(usize),
}

impl core::fmt::Display for Part {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Part::Top => f.write_str("the robot"),
            Part::Body(index) => write!(f, "body {index} (from 0)"),
            Part::Half(index) => write!(f, "half-sphere {index} (from 0)"),
            Part::Cube(index) => write!(f, "cube {index} (from 0)"),
            Part::Pair(index) => write!(f, "pair {index} (from 0)"),
        }
    }
}

/// A structure whose numbers are in range.
#[derive(Clone, Debug, PartialEq)]
pub struct Structure {
    /// Name for people.
    pub name: String,
    /// Edge of a cube, m.
    pub cube_m: f64,
    /// Radius of the ball, m.
    pub ball_radius_m: f64,
    /// Whether the base is bolted to the world.
    pub fixed_base: bool,
    /// Bodies; the base, and only it, has no hinge.
    pub bodies: Vec<Option<Hinge>>,
    /// Half-spheres.
    pub halves: Vec<Half>,
    /// Cubes as pairs of half-spheres.
    pub cubes: Vec<[usize; 2]>,
    /// Pairs of cubes that may meet.
    pub pairs: Vec<[usize; 2]>,
    /// Table profile of the motor drivers; `None`: the file does not say.
    pub driver: Option<Profile>,
    /// The file says that nobody checks whether its parts meet.
    pub unchecked: bool,
    lines: Vec<(Part, usize)>,
}

/// Why a structure file was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StructureError {
    /// Not TOML, an unknown or missing key, or a value of another type.
    #[error("{file}:{line}: {message}")]
    Read {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What the reader says.
        message: String,
    },
    /// Another version of the format.
    #[error("{file}:{line}: format = {found}, this program reads format = 1")]
    Format {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What the file says.
        found: i64,
    },
    /// Not finite or outside the range.
    #[error("{file}:{line}: `{key}` is {value}, allowed is {min} to {max}")]
    Range {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key with its table.
        key: &'static str,
        /// The refused value.
        value: f64,
        /// Smallest accepted value.
        min: f64,
        /// Largest accepted value.
        max: f64,
    },
    /// No such kind of motor driver.
    #[error("{file}:{line}: `bus.driver` is {value:?}, known: {known}")]
    Driver {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The refused name.
        value: String,
        /// The names that are known.
        known: String,
    },
    /// A direction without length.
    #[error(
        "{file}:{line}: `{key}` is {value:?}, which is no direction; give three finite numbers, not all zero"
    )]
    Direction {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key with its table.
        key: &'static str,
        /// The refused vector.
        value: [f64; 3],
    },
    /// The base has a hinge, or another body has none.
    #[error(
        "{file}:{line}: body {body} (from 0) {}",
        if *body == 0 { "is the base: leave parent, offset_m, axis, joint and motor away" } else { "needs parent, offset_m, axis, joint and motor" }
    )]
    Hinge {
        /// File name as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Index of the body.
        body: usize,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFile {
    format: Spanned<i64>,
    name: String,
    cube_m: Option<Spanned<f64>>,
    ball_radius_m: Option<Spanned<f64>>,
    #[serde(default)]
    fixed_base: bool,
    self_collision: Option<SelfCollision>,
    bus: Option<RawBus>,
    body: Vec<Spanned<RawBody>>,
    half: Vec<Spanned<RawHalf>>,
    cube: Vec<Spanned<RawCube>>,
    #[serde(default)]
    pair: Vec<Spanned<RawPair>>,
}

/// What a file may say of the check that its robot lacks.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum SelfCollision {
    Unchecked,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBus {
    driver: Spanned<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBody {
    parent: Option<usize>,
    offset_m: Option<Spanned<[f64; 3]>>,
    axis: Option<Spanned<[f64; 3]>>,
    joint: Option<usize>,
    motor: Option<Motor>,
    no_load_speed_rad_s: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawHalf {
    body: usize,
    centre_m: Spanned<[f64; 3]>,
    faces: [Spanned<[f64; 3]>; 3],
    mass_kg: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCube {
    halves: [usize; 2],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPair {
    cubes: [usize; 2],
}

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
}

impl Structure {
    /// Reads a structure file. `file` only appears in messages.
    ///
    /// # Errors
    /// Syntax, unknown, missing or misplaced keys, numbers out of range; each with file and line.
    pub fn parse(file: &str, text: &str) -> Result<Self, StructureError> {
        let reader = Reader { file, text };
        let raw: RawFile = toml::from_str(text).map_err(|error| StructureError::Read {
            file: file.to_owned(),
            line: reader.line(error.span().map_or(0, |span| span.start)),
            message: error.message().to_owned(),
        })?;
        let found = *raw.format.get_ref();
        if found != FORMAT {
            let line = reader.line(raw.format.span().start);
            let file = file.to_owned();
            return Err(StructureError::Format { file, line, found });
        }
        let mut lines = vec![(Part::Top, 1)];
        let mut bodies = Vec::new();
        for (index, body) in raw.body.iter().enumerate() {
            lines.push((Part::Body(index), reader.line(body.span().start)));
            bodies.push(reader.hinge(index, body)?);
        }
        let mut halves = Vec::new();
        for (index, half) in raw.half.iter().enumerate() {
            lines.push((Part::Half(index), reader.line(half.span().start)));
            halves.push(reader.half(half.get_ref())?);
        }
        for (index, cube) in raw.cube.iter().enumerate() {
            lines.push((Part::Cube(index), reader.line(cube.span().start)));
        }
        for (index, pair) in raw.pair.iter().enumerate() {
            lines.push((Part::Pair(index), reader.line(pair.span().start)));
        }
        Ok(Self {
            name: raw.name,
            cube_m: reader.size("cube_m", raw.cube_m.as_ref(), Key::Cube)?,
            ball_radius_m: reader.size(
                "ball_radius_m",
                raw.ball_radius_m.as_ref(),
                Key::BallRadius,
            )?,
            fixed_base: raw.fixed_base,
            unchecked: raw.self_collision.is_some(),
            driver: raw.bus.map(|bus| reader.driver(&bus.driver)).transpose()?,
            bodies,
            halves,
            cubes: raw.cube.iter().map(|c| c.get_ref().halves).collect(),
            pairs: raw.pair.iter().map(|p| p.get_ref().cubes).collect(),
            lines,
        })
    }

    /// Line at which a part begins, from 1.
    #[must_use]
    pub fn line(&self, part: Part) -> usize {
        let found = self.lines.iter().find(|(p, _)| *p == part);
        found.map_or(1, |(_, line)| *line)
    }
}

impl Reader<'_> {
    fn line(&self, at: usize) -> usize {
        1 + self
            .text
            .bytes()
            .take(at)
            .filter(|byte| *byte == b'\n')
            .count()
    }

    fn driver(&self, name: &Spanned<String>) -> Result<Profile, StructureError> {
        Profile::from_name(name.get_ref()).ok_or_else(|| StructureError::Driver {
            file: self.file.to_owned(),
            line: self.line(name.span().start),
            value: name.get_ref().clone(),
            known: Profile::ALL.map(|profile| profile.info().name).join(", "),
        })
    }

    fn in_range(
        &self,
        key: &'static str,
        at: usize,
        value: f64,
        (min, max): (f64, f64),
    ) -> Result<f64, StructureError> {
        if value >= min && value <= max {
            return Ok(value);
        }
        Err(StructureError::Range {
            file: self.file.to_owned(),
            line: self.line(at),
            key,
            value,
            min,
            max,
        })
    }

    /// A size of the cube; the model's default when absent.
    fn size(
        &self,
        key: &'static str,
        value: Option<&Spanned<f64>>,
        of: Key,
    ) -> Result<f64, StructureError> {
        let info = of.info();
        value.map_or(Ok(info.hand), |value| {
            let at = value.span().start;
            self.in_range(key, at, *value.get_ref(), (info.min, info.max))
        })
    }

    fn place(
        &self,
        key: &'static str,
        place: &Spanned<[f64; 3]>,
    ) -> Result<[f64; 3], StructureError> {
        let limits = (-LENGTH_LIMIT_M, LENGTH_LIMIT_M);
        for value in place.get_ref() {
            self.in_range(key, place.span().start, *value, limits)?;
        }
        Ok(*place.get_ref())
    }

    fn direction(
        &self,
        key: &'static str,
        vector: &Spanned<[f64; 3]>,
    ) -> Result<[f64; 3], StructureError> {
        let v = *vector.get_ref();
        let squared: f64 = v.iter().map(|x| x * x).sum();
        if !(squared.is_finite() && squared > UNIT_TOLERANCE) {
            return Err(StructureError::Direction {
                file: self.file.to_owned(),
                line: self.line(vector.span().start),
                key,
                value: v,
            });
        }
        if (squared - 1.0).abs() <= UNIT_TOLERANCE {
            return Ok(v);
        }
        let length = squared.sqrt();
        Ok(v.map(|x| x / length))
    }

    fn hinge(
        &self,
        index: usize,
        body: &Spanned<RawBody>,
    ) -> Result<Option<Hinge>, StructureError> {
        let b = body.get_ref();
        let speed = b.no_load_speed_rad_s.as_ref().map(|speed| {
            let at = speed.span().start;
            self.in_range(
                "body.no_load_speed_rad_s",
                at,
                *speed.get_ref(),
                SPEED_RAD_S,
            )
        });
        match (index, b.parent, &b.offset_m, &b.axis, b.joint, b.motor) {
            (0, None, None, None, None, None) if b.no_load_speed_rad_s.is_none() => Ok(None),
            (1.., Some(parent), Some(offset_m), Some(axis), Some(joint), Some(motor)) => {
                Ok(Some(Hinge {
                    parent,
                    offset_m: self.place("body.offset_m", offset_m)?,
                    axis: self.direction("body.axis", axis)?,
                    joint,
                    motor,
                    no_load_speed_rad_s: speed.transpose()?,
                }))
            }
            _ => Err(StructureError::Hinge {
                file: self.file.to_owned(),
                line: self.line(body.span().start),
                body: index,
            }),
        }
    }

    fn half(&self, half: &RawHalf) -> Result<Half, StructureError> {
        let [a, b, c] = &half.faces;
        let face = |face| self.direction("half.faces", face);
        let mass_kg = half.mass_kg.as_ref().map(|mass| {
            let at = mass.span().start;
            self.in_range("half.mass_kg", at, *mass.get_ref(), MASS_KG)
        });
        Ok(Half {
            body: half.body,
            centre_m: self.place("half.centre_m", &half.centre_m)?,
            faces: [face(a)?, face(b)?, face(c)?],
            mass_kg: mass_kg.transpose()?,
        })
    }
}
