//! The virtual overhead camera.

use crate::{Silhouette, Solid};
use control::linalg::{Pose, Vec3};

/// A pinhole camera that looks straight down; image x runs along the camera's x axis, image y against its y axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    height_m: f32,
    x_m: f32,
    y_m: f32,
    yaw_rad: f32,
    width_px: usize,
    height_px: usize,
    focal_px: f32,
}

/// Why a view was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ViewError {
    /// A length is not positive and finite.
    #[error("camera {field} is {value}; it must be finite and above {above}")]
    OutOfRange {
        /// Name of the parameter.
        field: &'static str,
        /// Value as given.
        value: f32,
        /// Exclusive lower end.
        above: f32,
    },
    /// No pixel, or more than a sensor has.
    #[error("a frame of {width_px} x {height_px} pixels; 1 to 4096 each")]
    Size {
        /// Width as given.
        width_px: usize,
        /// Height as given.
        height_px: usize,
    },
}

/// Largest edge of a frame; far above the Kinect's 640.
const MAX_EDGE_PX: usize = 4096;

impl View {
    /// A camera `height_m` above the ground over (`x_m`, `y_m`), turned by `yaw_rad` about the vertical.
    ///
    /// `focal_px` is the focal length in pixels; a Kinect's depth image has about 580 at 640 x 480
    /// (its nominal horizontal field of view of 57 degrees).
    ///
    /// # Errors
    /// See [`ViewError`].
    pub fn new(
        height_m: f32,
        (x_m, y_m): (f32, f32),
        yaw_rad: f32,
        (width_px, height_px): (usize, usize),
        focal_px: f32,
    ) -> Result<Self, ViewError> {
        for (field, value, above) in [
            ("height_m", height_m, 0.0),
            ("focal_px", focal_px, 0.0),
            ("x_m", x_m, f32::NEG_INFINITY),
            ("y_m", y_m, f32::NEG_INFINITY),
            ("yaw_rad", yaw_rad, f32::NEG_INFINITY),
        ] {
            if !(value.is_finite() && value > above) {
                return Err(ViewError::OutOfRange {
                    field,
                    value,
                    above,
                });
            }
        }
        if !(1..=MAX_EDGE_PX).contains(&width_px) || !(1..=MAX_EDGE_PX).contains(&height_px) {
            return Err(ViewError::Size {
                width_px,
                height_px,
            });
        }
        Ok(Self {
            height_m,
            x_m,
            y_m,
            yaw_rad,
            width_px,
            height_px,
            focal_px,
        })
    }

    /// The same view with `factor` times fewer pixels per edge, for searches.
    #[must_use]
    pub fn coarser(self, factor: usize) -> Self {
        let factor = factor.max(1);
        Self {
            width_px: (self.width_px / factor).max(1),
            height_px: (self.height_px / factor).max(1),
            focal_px: self.focal_px / factor as f32,
            ..self
        }
    }

    /// Frame size (width, height) in pixels.
    #[must_use]
    pub fn size_px(&self) -> (usize, usize) {
        (self.width_px, self.height_px)
    }

    /// Where a world point appears; `None` at or above the camera.
    #[must_use]
    pub fn project(&self, p_m: Vec3) -> Option<[f32; 2]> {
        let (sin, cos) = self.turn();
        self.project_turned(p_m, sin, cos)
    }

    /// Where the camera is, m.
    pub(crate) fn eye_m(&self) -> Vec3 {
        Vec3::new(self.x_m, self.y_m, self.height_m)
    }

    /// Sine and cosine of the yaw.
    pub(crate) fn turn(&self) -> (f32, f32) {
        (libm::sinf(self.yaw_rad), libm::cosf(self.yaw_rad))
    }

    pub(crate) fn project_turned(&self, p_m: Vec3, sin: f32, cos: f32) -> Option<[f32; 2]> {
        let depth_m = self.height_m - p_m.z;
        if depth_m <= 0.0 {
            return None;
        }
        let (dx, dy) = (p_m.x - self.x_m, p_m.y - self.y_m);
        let scale = self.focal_px / depth_m;
        Some([
            0.5 * self.width_px as f32 + scale * (cos * dx + sin * dy),
            0.5 * self.height_px as f32 - scale * (cos * dy - sin * dx),
        ])
    }

    /// The outline of `solids` with their bodies at `poses`; a solid of a missing body is not drawn.
    #[must_use]
    pub fn render(&self, solids: &[Solid], poses: &[Pose]) -> Silhouette {
        let mut frame = Silhouette::new(self.width_px, self.height_px);
        let (sin, cos) = self.turn();
        let (mut outline, mut spans) = (Vec::new(), Vec::new());
        for solid in solids {
            let Some(pose) = poses.get(solid.body) else {
                continue;
            };
            outline.clear();
            let world = solid.points_m.iter().map(|&p| pose.transform(p));
            outline.extend(world.filter_map(|p| self.project_turned(p, sin, cos)));
            frame.fill_hull(&mut outline, &mut spans);
        }
        frame
    }
}
