//! What touches what, and how hard.

use crate::units;
use rapier3d::prelude::PhysicsWorld;
use tdv_geometry::nalgebra::Vector3;

/// Whose surface a collider is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Tag {
    Table,
    Floor,
    Arm,
    FingerA,
    FingerB,
    Object(u32),
}

impl Tag {
    pub(crate) fn to_user_data(self) -> u128 {
        match self {
            Self::Table => 1,
            Self::Floor => 2,
            Self::Arm => 3,
            Self::FingerA => 4,
            Self::FingerB => 5,
            Self::Object(i) => 16 + u128::from(i),
        }
    }

    fn from_user_data(data: u128) -> Option<Self> {
        Some(match data {
            1 => Self::Table,
            2 => Self::Floor,
            3 => Self::Arm,
            4 => Self::FingerA,
            5 => Self::FingerB,
            n if n >= 16 => Self::Object(u32::try_from(n - 16).ok()?),
            _ => return None,
        })
    }

    fn is_robot(self) -> bool {
        matches!(self, Self::Arm | Self::FingerA | Self::FingerB)
    }
}

/// Surfaces farther apart than this (m) do not touch.
const APART: f32 = 0.001;

/// What one object touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ObjectContacts {
    /// The finger on the +y side of the tool, the one on the -y side.
    pub fingers: [bool; 2],
    /// The palm or a link.
    pub arm: bool,
    /// The table top.
    pub table: bool,
    /// The floor: it has fallen off the table.
    pub floor: bool,
}

impl ObjectContacts {
    /// Whether any part of the robot touches it.
    pub fn robot(&self) -> bool {
        self.arm || self.fingers[0] || self.fingers[1]
    }
}

/// All contacts after a tick.
#[derive(Debug, Clone, Default)]
pub struct Contacts {
    /// One entry per object.
    pub objects: Vec<ObjectContacts>,
    /// Sum of the forces that the surroundings exert on arm, palm and fingers, N in `base_link`. The
    /// squeeze of a grasp cancels in it.
    pub robot_force: Vector3<f64>,
    /// How deep an arm link or the palm is in something that cannot give way, m: no force stops a
    /// robot that is moved by its joints alone.
    pub crash_depth: f64,
}

impl Contacts {
    pub(crate) fn read(physics: &PhysicsWorld, objects: usize, dt: f64) -> Self {
        let substeps = physics.integration_parameters.num_solver_iterations as f64;
        let mut out = Self { objects: vec![ObjectContacts::default(); objects], ..Self::default() };
        for pair in physics.narrow_phase.contact_pairs() {
            let tag = |h| physics.colliders.get(h).and_then(|c| Tag::from_user_data(c.user_data));
            let (Some(a), Some(b)) = (tag(pair.collider1), tag(pair.collider2)) else { continue };
            // Friction counts too, else an object lying in the fingers would weigh nothing.
            let mut on_second = Vector3::zeros();
            let mut touching = false;
            for manifold in pair.solver_manifolds() {
                let normal = units::vector64(manifold.data.normal);
                for point in &manifold.points {
                    // A point that the solver has left out keeps its last impulse.
                    if point.data.impulse <= 0.0 || point.dist > APART {
                        continue;
                    }
                    touching = true;
                    on_second += normal * (f64::from(point.data.impulse) / dt);
                    // The normal impulse is the tick's sum, the tangential one the last sub-step's,
                    // and it is written for the first body.
                    on_second -=
                        units::vector64(point.data.warmstart_tangent_world) * (substeps / dt);
                }
            }
            let immovable = |h| {
                let body = physics.colliders.get(h).and_then(|c| c.parent());
                body.and_then(|b| physics.bodies.get(b)).is_some_and(|b| b.is_fixed())
            };
            if (a == Tag::Arm && immovable(pair.collider2))
                || (b == Tag::Arm && immovable(pair.collider1))
            {
                let points = pair.manifolds().iter().flat_map(|m| &m.points);
                let depth = points.map(|p| -f64::from(p.dist)).fold(0.0, f64::max);
                out.crash_depth = out.crash_depth.max(depth);
            }
            if !touching {
                continue;
            }
            if a.is_robot() != b.is_robot() {
                out.robot_force += if b.is_robot() { on_second } else { -on_second };
            }
            out.note(a, b);
            out.note(b, a);
        }
        out
    }

    fn note(&mut self, who: Tag, other: Tag) {
        let Tag::Object(i) = who else { return };
        let Some(o) = self.objects.get_mut(i as usize) else { return };
        match other {
            Tag::Table => o.table = true,
            Tag::Floor => o.floor = true,
            Tag::Arm => o.arm = true,
            Tag::FingerA => o.fingers[0] = true,
            Tag::FingerB => o.fingers[1] = true,
            Tag::Object(_) => {}
        }
    }
}
