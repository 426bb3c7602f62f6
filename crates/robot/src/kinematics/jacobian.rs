use super::{Joints, Kinematics};
use nalgebra::{Matrix6, Point3, Vector3, Vector6};

/// How far an arm is from its three kinds of singularity, and overall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dexterity {
    /// `|sin q5|`: 0 where wrist 1 and wrist 3 turn about one line.
    pub wrist: f64,
    /// `|sin q3|`: 0 where the elbow is stretched or folded.
    pub elbow: f64,
    /// Distance (m) of the wrist centre from the shoulder axis, measured along the arm's plane.
    pub shoulder: f64,
    /// `|det J|` (m^3): Yoshikawa's manipulability of a six-joint arm.
    pub manipulability: f64,
    /// Ratio of the greatest to the least singular value of J, with lengths in units of 0.5 m;
    /// infinite at a singularity.
    pub condition: f64,
}

impl Kinematics {
    /// Geometric Jacobian at `tool0` in `base_link` axes: rows are linear (m/s) then angular (rad/s)
    /// velocity, columns the joints.
    pub fn jacobian(&self, q: &Joints) -> Matrix6<f64> {
        self.jacobian_at(q, &Point3::origin())
    }

    /// As [`Self::jacobian`] at the `tcp`.
    pub fn jacobian_tcp(&self, q: &Joints) -> Matrix6<f64> {
        self.jacobian_at(q, &Point3::from(self.tool().translation.vector))
    }

    /// As [`Self::jacobian`] at a point fixed to the flange, given in `tool0` (m).
    pub fn jacobian_at(&self, q: &Joints, point: &Point3<f64>) -> Matrix6<f64> {
        let frames = self.frames(q);
        let p = frames[6] * point;
        let mut j = Matrix6::zeros();
        for i in 0..6 {
            let z = frames[i].rotation * Vector3::z();
            let arm = p.coords - frames[i].translation.vector;
            j.fixed_view_mut::<3, 1>(0, i).copy_from(&z.cross(&arm));
            j.fixed_view_mut::<3, 1>(3, i).copy_from(&z);
        }
        j
    }

    /// Speed of the `tcp` (m/s) and its angular speed (rad/s) at joint velocities `qd` (rad/s).
    pub fn tcp_speed(&self, q: &Joints, qd: &Joints) -> (f64, f64) {
        let v = self.jacobian_tcp(q) * Vector6::from(*qd);
        (v.fixed_rows::<3>(0).norm(), v.fixed_rows::<3>(3).norm())
    }

    /// Distance from singularities.
    pub fn dexterity(&self, q: &Joints) -> Dexterity {
        let mut j = self.jacobian(q);
        let manipulability = j.determinant().abs();
        for mut row in j.row_iter_mut().take(3) {
            row /= 0.5;
        }
        let s = j.singular_values();
        let condition = if s.min() > 1e-12 { s.max() / s.min() } else { f64::INFINITY };
        let frames = self.nominal_frames(q);
        let wrist_centre = frames[0].inverse() * frames[5].translation.vector;
        let d4 = self.dh().d4;
        Dexterity {
            wrist: q[4].sin().abs(),
            elbow: q[2].sin().abs(),
            shoulder: (wrist_centre.xy().norm_squared() - d4 * d4).max(0.0).sqrt(),
            manipulability,
            condition,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn agrees_with_finite_differences() {
        let k = Kinematics::ur5();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let h = 1e-6;
        for _ in 0..200 {
            let q: Joints = std::array::from_fn(|_| rng.random_range(-3.0..3.0));
            let j = k.jacobian_tcp(&q);
            for i in 0..6 {
                let (mut a, mut b) = (q, q);
                a[i] -= h;
                b[i] += h;
                let (a, b) = (k.fk_tcp(&a), k.fk_tcp(&b));
                let v = (b.translation.vector - a.translation.vector) / (2.0 * h);
                let w = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * h);
                assert!((j.fixed_view::<3, 1>(0, i) - v).norm() < 1e-6);
                assert!((j.fixed_view::<3, 1>(3, i) - w).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn singular_where_it_should_be() {
        let k = Kinematics::ur5();
        let good = k.dexterity(&[0.2, -1.3, 1.7, -2.0, -1.6, 0.4]);
        assert!(good.manipulability > 0.01 && good.condition < 30.0, "{good:?}");
        let wrist = k.dexterity(&[0.2, -1.3, 1.7, -2.0, 0.0, 0.4]);
        assert!(wrist.manipulability < 1e-12 && wrist.condition > 1e6, "{wrist:?}");
        let elbow = k.dexterity(&[0.2, -1.3, 0.0, -2.0, -1.6, 0.4]);
        assert!(elbow.manipulability < 1e-12 && elbow.elbow == 0.0);
    }

    #[test]
    fn shoulder_distance_vanishes_on_the_base_axis() {
        let k = Kinematics::ur5();
        let q = [0.3, -1.3, 1.7, -2.0, -1.6, 0.4];
        let d = k.dexterity(&q).shoulder;
        let turned = k.dexterity(&[1.9, -1.3, 1.7, -2.0, -1.6, 0.4]).shoulder;
        assert!(d > 0.2 && (d - turned).abs() < 1e-12);
    }
}
