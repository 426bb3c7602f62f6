use crate::kinematics::Joints;

/// A point of the active trajectory in UR order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Knot {
    /// Seconds from the executor's start.
    pub time: f64,
    pub q: Joints,
    pub qd: Option<Joints>,
    pub qdd: Option<Joints>,
}

/// Position and velocity at `t` between two knots.
pub(super) fn sample(a: &Knot, b: &Knot, t: f64) -> (Joints, Joints) {
    let h = b.time - a.time;
    let x = ((t - a.time) / h).clamp(0.0, 1.0);
    let mut out = ([0.0; 6], [0.0; 6]);
    for i in 0..6 {
        let (p, v) = match (a.qd.zip(b.qd), a.qdd.zip(b.qdd)) {
            (Some((va, vb)), Some((aa, ab))) => {
                quintic([a.q[i], va[i], aa[i]], [b.q[i], vb[i], ab[i]], h, x)
            }
            (Some((va, vb)), None) => cubic([a.q[i], va[i]], [b.q[i], vb[i]], h, x),
            _ => (a.q[i] + (b.q[i] - a.q[i]) * x, (b.q[i] - a.q[i]) / h),
        };
        out.0[i] = p;
        out.1[i] = v;
    }
    out
}

/// Hermite: ends are `[position, velocity]`, `h` the duration, `x` the fraction of it.
fn cubic(a: [f64; 2], b: [f64; 2], h: f64, x: f64) -> (f64, f64) {
    let d = b[0] - a[0];
    let (va, vb) = (a[1] * h, b[1] * h);
    let (c2, c3) = (3.0 * d - 2.0 * va - vb, va + vb - 2.0 * d);
    (a[0] + x * (va + x * (c2 + x * c3)), (va + x * (2.0 * c2 + x * 3.0 * c3)) / h)
}

/// Hermite: ends are `[position, velocity, acceleration]`.
fn quintic(a: [f64; 3], b: [f64; 3], h: f64, x: f64) -> (f64, f64) {
    let (va, vb) = (a[1] * h, b[1] * h);
    let (aa, ab) = (a[2] * h * h, b[2] * h * h);
    let c2 = 0.5 * aa;
    // What is left for the three highest terms at the end: position, velocity, acceleration.
    let d = b[0] - a[0] - va - c2;
    let e = vb - va - aa;
    let f = ab - aa;
    let c3 = 10.0 * d - 4.0 * e + 0.5 * f;
    let c4 = -15.0 * d + 7.0 * e - f;
    let c5 = 6.0 * d - 3.0 * e + 0.5 * f;
    let p = a[0] + x * (va + x * (c2 + x * (c3 + x * (c4 + x * c5))));
    let v = va + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)));
    (p, v / h)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_reproduced() {
        // p = 1 + 2t - t^2 + 0.5 t^3 is a cubic and (a fortiori) a quintic.
        let p = |t: f64| 1.0 + 2.0 * t - t * t + 0.5 * t * t * t;
        let v = |t: f64| 2.0 - 2.0 * t + 1.5 * t * t;
        let a = |t: f64| -2.0 + 3.0 * t;
        let (t0, t1) = (0.3, 1.1);
        for x in [0.0, 0.2, 0.7, 1.0] {
            let t = t0 + x * (t1 - t0);
            let c = cubic([p(t0), v(t0)], [p(t1), v(t1)], t1 - t0, x);
            let q = quintic([p(t0), v(t0), a(t0)], [p(t1), v(t1), a(t1)], t1 - t0, x);
            for (got, want) in [(c.0, p(t)), (c.1, v(t)), (q.0, p(t)), (q.1, v(t))] {
                assert!((got - want).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_quintic_meets_its_ends() {
        let (a, b, h) = ([0.1, -0.4, 2.0], [0.5, 0.3, -1.0], 0.4);
        let e = 1e-6;
        assert!((quintic(a, b, h, 0.0).1 - a[1]).abs() < 1e-12);
        assert!((quintic(a, b, h, 1.0).0 - b[0]).abs() < 1e-12);
        let at_end = (quintic(a, b, h, 1.0).1 - quintic(a, b, h, 1.0 - e).1) / (e * h);
        assert!((at_end - b[2]).abs() < 1e-3, "{at_end}");
    }
}
