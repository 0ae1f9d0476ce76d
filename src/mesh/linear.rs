//! Small dense linear algebra: symmetric eigenvectors and positive definite systems.

/// Largest number of sweeps of Jacobi's method, which converges quadratically, in 5 or 6.
const SWEEPS: usize = 24;

/// Eigenvalues and eigenvectors of a symmetric matrix by cyclic Jacobi rotations (Golub and Van
/// Loan, section 8.5). Vector `k` is `vectors[k]`; the order is that of the diagonal.
#[must_use]
pub fn eigen<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut v = [[0.0; N]; N];
    for (i, row) in v.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for _ in 0..SWEEPS {
        let off: f64 =
            (0..N).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i][j].abs()).sum();
        if off.is_nan() || off <= f64::MIN_POSITIVE {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                rotate(&mut a, &mut v, p, q);
            }
        }
    }
    (std::array::from_fn(|i| a[i][i]), v)
}

/// Makes `a[p][q]` zero.
fn rotate<const N: usize>(a: &mut [[f64; N]; N], v: &mut [[f64; N]; N], p: usize, q: usize) {
    if a[p][q].abs() <= f64::MIN_POSITIVE {
        return;
    }
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let t = theta.signum() / (theta.abs() + libm::hypot(theta, 1.0));
    let c = 1.0 / libm::hypot(t, 1.0);
    let s = t * c;
    let turn = |x: &mut f64, y: &mut f64| (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
    for row in a.iter_mut() {
        let (mut x, mut y) = (row[p], row[q]);
        turn(&mut x, &mut y);
        (row[p], row[q]) = (x, y);
    }
    for matrix in [a, v] {
        let (head, tail) = matrix.split_at_mut(q);
        head[p].iter_mut().zip(&mut tail[0]).for_each(|(x, y)| turn(x, y));
    }
}

/// Solves `a x = b` for a symmetric positive definite `a` by Cholesky's method; `None` where `a` is not
/// positive definite to working precision.
#[must_use]
pub fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    for i in 0..N {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            let rest = a[i][j] - dot;
            if i == j {
                if rest.is_nan() || rest <= 1e-14 * a[i][i].abs() {
                    return None;
                }
                a[i][i] = rest.sqrt();
            } else {
                a[i][j] = rest / a[j][j];
            }
        }
    }
    for i in 0..N {
        let dot: f64 = (0..i).map(|k| a[i][k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i][i];
    }
    for i in (0..N).rev() {
        let dot: f64 = (i + 1..N).map(|k| a[k][i] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i][i];
    }
    Some(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [[f64; 3]; 3] = [[4.0, 1.0, -2.0], [1.0, 5.0, 0.5], [-2.0, 0.5, 3.0]];

    fn times(a: &[[f64; 3]; 3], x: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| (0..3).map(|k| a[i][k] * x[k]).sum())
    }

    #[test]
    fn eigenvectors_are_only_stretched() {
        let (values, vectors) = eigen(A);
        for (value, vector) in values.iter().zip(&vectors) {
            let image = times(&A, vector);
            assert!((0..3).all(|i| (image[i] - value * vector[i]).abs() < 1e-12));
        }
        assert!((values.iter().sum::<f64>() - 12.0).abs() < 1e-12);
        let (_, identity) = eigen([[2.0, 0.0], [0.0, 2.0]]);
        assert_eq!(identity, [[1.0, 0.0], [0.0, 1.0]]);
    }

    #[test]
    fn solutions_solve_and_singular_systems_are_refused() {
        let x = solve(A, [1.0, -2.0, 0.5]).unwrap();
        let back = times(&A, &x);
        assert!((0..3).all(|i| (back[i] - [1.0, -2.0, 0.5][i]).abs() < 1e-12));
        assert!(solve([[1.0, 1.0], [1.0, 1.0]], [1.0, 2.0]).is_none());
        assert!(solve([[f64::NAN]], [1.0]).is_none());
    }
}
