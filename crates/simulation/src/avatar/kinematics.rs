use nalgebra::{Point3, Unit, Vector3};
use tdv_geometry::Pose;

/// Bone lengths (m) of an adult's right hand. Typical proportions, own numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct HandShape {
    /// Thumb CMC joint in the palm frame.
    pub thumb_base: [f64; 3],
    /// Thumb metacarpal, proximal and distal phalanx.
    pub thumb: [f64; 3],
    /// Knuckles (MCP) of index, middle, ring and little finger in the palm frame.
    pub knuckles: [[f64; 3]; 4],
    /// Proximal, middle and distal phalanx of the four fingers.
    pub fingers: [[f64; 3]; 4],
    /// Direction of the straight fingers in the palm plane (rad, towards the thumb positive).
    pub fan: [f64; 4],
}

impl HandShape {
    /// A hand 0.19 m long times `scale`.
    pub fn scaled(scale: f64) -> Self {
        let s3 = |v: [f64; 3]| v.map(|x| x * scale);
        Self {
            thumb_base: s3([0.026, 0.026, -0.010]),
            thumb: s3([0.046, 0.036, 0.028]),
            knuckles: [
                s3([0.095, 0.026, 0.002]),
                s3([0.096, 0.004, 0.005]),
                s3([0.090, -0.016, 0.003]),
                s3([0.081, -0.034, -0.002]),
            ],
            fingers: [
                s3([0.045, 0.026, 0.022]),
                s3([0.050, 0.030, 0.023]),
                s3([0.046, 0.028, 0.023]),
                s3([0.036, 0.021, 0.021]),
            ],
            fan: [0.06, 0.0, -0.05, -0.13],
        }
    }

    /// The 21 joints (m) in the frame that `pose.palm` is given in.
    pub fn joints(&self, pose: &HandPose) -> [Point3<f64>; 21] {
        let mut out = [Point3::origin(); 21];
        let base = Point3::from(self.thumb_base);
        let directions = pose.thumb.directions();
        out[1] = base;
        for (k, direction) in directions.iter().enumerate() {
            out[k + 2] = out[k + 1] + direction.into_inner() * self.thumb[k];
        }
        for (f, finger) in pose.fingers.iter().enumerate() {
            let mut p = Point3::from(self.knuckles[f]);
            out[5 + 4 * f] = p;
            let spread = self.fan[f] + finger.spread;
            let mut bend = 0.0;
            for (k, flex) in [finger.mcp, finger.pip, finger.dip].into_iter().enumerate() {
                bend += flex;
                let along =
                    Vector3::new(bend.cos() * spread.cos(), bend.cos() * spread.sin(), -bend.sin());
                p += along * self.fingers[f][k];
                out[6 + 4 * f + k] = p;
            }
        }
        out.map(|p| pose.palm * p)
    }
}

impl Default for HandShape {
    /// A large hand, 0.205 m.
    fn default() -> Self {
        Self::scaled(1.08)
    }
}

/// Joint angles of a finger (rad); positive flexes towards the palm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FingerPose {
    /// Sideways, towards the thumb positive.
    pub spread: f64,
    /// Knuckle.
    pub mcp: f64,
    /// Middle joint.
    pub pip: f64,
    /// End joint.
    pub dip: f64,
}

/// Joint angles of the thumb (rad).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ThumbPose {
    /// Direction of the metacarpal in the palm plane, from x towards the thumb's side.
    pub abduction: f64,
    /// Its elevation out of the palm plane, towards the palm's inside.
    pub opposition: f64,
    /// Turn of the flexion plane about the metacarpal: 0 flexes across the palm, -pi/2 back towards
    /// the fingers, as when thumb and fingers hold something between them.
    pub roll: f64,
    /// Flexion of the MCP joint.
    pub mcp: f64,
    /// Flexion of the IP joint.
    pub ip: f64,
}

impl ThumbPose {
    /// Directions of the three thumb bones in the palm frame.
    fn directions(&self) -> [Unit<Vector3<f64>>; 3] {
        let (se, ce) = self.opposition.sin_cos();
        let (sa, ca) = self.abduction.sin_cos();
        let bone = Vector3::new(ce * ca, ce * sa, -se);
        // Perpendicular to the bone: towards the palm's inside, and across the palm.
        let inside = Vector3::new(-se * ca, -se * sa, -ce);
        let across = inside.cross(&bone);
        let (sr, cr) = self.roll.sin_cos();
        let towards = across * cr + inside * sr;
        [0.0, self.mcp, self.mcp + self.ip]
            .map(|angle| Unit::new_normalize(bone * angle.cos() + towards * angle.sin()))
    }
}

/// Where a hand is and how it is bent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandPose {
    /// T_parent_palm.
    pub palm: Pose,
    /// The thumb.
    pub thumb: ThumbPose,
    /// Index, middle, ring, little.
    pub fingers: [FingerPose; 4],
}

impl HandPose {
    /// A relaxed open hand.
    pub fn relaxed(palm: Pose) -> Self {
        let finger = |mcp: f64, pip: f64| FingerPose { spread: 0.0, mcp, pip, dip: 0.6 * pip };
        Self {
            palm,
            thumb: ThumbPose { abduction: 0.75, opposition: 0.45, roll: -0.5, mcp: 0.15, ip: 0.15 },
            fingers: [finger(0.2, 0.25), finger(0.25, 0.3), finger(0.3, 0.35), finger(0.3, 0.35)],
        }
    }

    /// Between two bends (0 = `self`, 1 = `other`), the palm interpolated as well.
    #[must_use]
    pub fn blend(&self, other: &Self, t: f64) -> Self {
        let mix = |a: f64, b: f64| a + (b - a) * t;
        let (a, b) = (&self.thumb, &other.thumb);
        Self {
            palm: tdv_geometry::interpolate(&self.palm, &other.palm, t),
            thumb: ThumbPose {
                abduction: mix(a.abduction, b.abduction),
                opposition: mix(a.opposition, b.opposition),
                roll: mix(a.roll, b.roll),
                mcp: mix(a.mcp, b.mcp),
                ip: mix(a.ip, b.ip),
            },
            fingers: std::array::from_fn(|f| {
                let (a, b) = (&self.fingers[f], &other.fingers[f]);
                FingerPose {
                    spread: mix(a.spread, b.spread),
                    mcp: mix(a.mcp, b.mcp),
                    pip: mix(a.pip, b.pip),
                    dip: mix(a.dip, b.dip),
                }
            }),
        }
    }
}
