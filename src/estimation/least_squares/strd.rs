//! Problems of NIST's Statistical Reference Datasets for nonlinear regression (<https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml>, 1997),
//! with their certified parameters and standard deviations, from both of their starts. Data are as published there.

use super::*;
use nalgebra::Vector1;

/// A model with N parameters b: its value at x, and its derivatives by the parameters.
type Model<const N: usize> = fn(f64, &SVector<f64, N>) -> (f64, [f64; N]);

struct Problem<const N: usize> {
    model: Model<N>,
    starts: [[f64; N]; 2],
    /// Certified values, and the standard deviation of each.
    values: [f64; N],
    deviations: [f64; N],
    /// Pairs (y, x).
    data: &'static [(f64, f64)],
}

impl<const N: usize> Problem<N> {
    /// Fits with unit weights: the scale is the residual standard deviation. The stated sigmas are too small by a factor, so that they
    /// are inflated.
    fn fit(&self, start: [f64; N]) -> Result<Fitted<N>, FitError> {
        const STATED: f64 = 1e-6;
        let fit = LeastSquares {
            start: start.into(),
            prior: Prior::none(),
            loss: Loss::Squares,
            scale: Scale::Inflated,
            tolerance_sigmas: 1e-10,
        };
        fit.fit(|b| {
            let row = |&(y, x): &(f64, f64)| {
                let (value, derivatives) = (self.model)(x, b);
                Linearised {
                    residual: Vector1::new(y - value) / STATED,
                    jacobian: SVector::from(derivatives).transpose() / STATED,
                }
            };
            let rows: Vec<_> = self.data.iter().map(row).collect();
            let all_finite = rows.iter().all(|row| row.residual.x.is_finite());
            all_finite.then_some(rows)
        })
    }

    /// Checks the certified values to seven digits, and the certified deviations to six, from every start.
    fn holds(&self) {
        for start in self.starts {
            let fitted = self.fit(start).unwrap();
            for n in 0..N {
                let Measured { value, sigma } = fitted.measured(n);
                let (certified, deviation) = (self.values[n], self.deviations[n]);
                let off = (value / certified - 1.0).abs();
                assert!(off < 1e-7, "b{} from {start:?}: {value}, {off:e}", n + 1);
                let off = (sigma / deviation - 1.0).abs();
                assert!(off < 1e-6, "sd{} from {start:?}: {sigma}, {off:e}", n + 1);
            }
        }
    }
}

#[test]
fn misra1a_an_exponential_of_lower_difficulty() {
    let problem = Problem {
        model: |x, b| {
            let left = (-b[1] * x).exp();
            (b[0] * (1.0 - left), [1.0 - left, b[0] * x * left])
        },
        starts: [[500.0, 1e-4], [250.0, 5e-4]],
        values: [2.3894212918e2, 5.5015643181e-4],
        deviations: [2.7070075241, 7.2668688436e-6],
        data: &[
            (10.07, 77.6),
            (14.73, 114.9),
            (17.94, 141.1),
            (23.93, 190.8),
            (29.61, 239.9),
            (35.18, 289.0),
            (40.02, 332.8),
            (44.82, 378.4),
            (50.76, 434.8),
            (55.05, 477.3),
            (61.01, 536.8),
            (66.40, 593.1),
            (75.47, 689.1),
            (81.78, 760.0),
        ],
    };
    problem.holds();
}

#[test]
fn danwood_a_power_of_lower_difficulty() {
    let problem = Problem {
        model: |x, b| {
            let power = x.powf(b[1]);
            (b[0] * power, [power, b[0] * power * x.ln()])
        },
        starts: [[1.0, 5.0], [0.7, 4.0]],
        values: [7.6886226176e-1, 3.8604055871],
        deviations: [1.8281973860e-2, 5.1726610913e-2],
        data: &[
            (2.138, 1.309),
            (3.421, 1.471),
            (3.597, 1.490),
            (4.340, 1.565),
            (4.882, 1.611),
            (5.660, 1.680),
        ],
    };
    problem.holds();
}

#[test]
fn chwirut2_an_exponential_over_a_line_of_lower_difficulty() {
    let problem = Problem {
        model: |x, b| {
            let below = b[1] + b[2] * x;
            let value = (-b[0] * x).exp() / below;
            (value, [-x * value, -value / below, -x * value / below])
        },
        starts: [[0.1, 0.01, 0.02], [0.15, 0.008, 0.010]],
        values: [1.6657666537e-1, 5.1653291286e-3, 1.2150007096e-2],
        deviations: [3.8303286810e-2, 6.6621605126e-4, 1.5304234767e-3],
        data: &[
            (92.9, 0.5),
            (57.1, 1.0),
            (31.05, 1.75),
            (11.5875, 3.75),
            (8.025, 5.75),
            (63.6, 0.875),
            (21.4, 2.25),
            (14.25, 3.25),
            (8.475, 5.25),
            (63.8, 0.75),
            (26.8, 1.75),
            (16.4625, 2.75),
            (7.125, 4.75),
            (67.3, 0.625),
            (41.0, 1.25),
            (21.15, 2.25),
            (8.175, 4.25),
            (81.5, 0.5),
            (13.12, 3.0),
            (59.9, 0.75),
            (14.62, 3.0),
            (32.9, 1.5),
            (5.44, 6.0),
            (12.56, 3.0),
            (5.44, 6.0),
            (32.0, 1.5),
            (13.95, 3.0),
            (75.8, 0.5),
            (20.0, 2.0),
            (10.42, 4.0),
            (59.5, 0.75),
            (21.67, 2.0),
            (8.55, 5.0),
            (62.0, 0.75),
            (20.2, 2.25),
            (7.76, 3.75),
            (3.75, 5.75),
            (11.81, 3.0),
            (54.7, 0.75),
            (23.7, 2.5),
            (11.55, 4.0),
            (61.3, 0.75),
            (17.7, 2.5),
            (8.74, 4.0),
            (59.2, 0.75),
            (16.3, 2.5),
            (8.62, 4.0),
            (81.0, 0.5),
            (4.87, 6.0),
            (14.62, 3.0),
            (81.7, 0.5),
            (17.17, 2.75),
            (81.3, 0.5),
            (28.9, 1.75),
        ],
    };
    problem.holds();
}

#[test]
fn eckerle4_a_gaussian_of_higher_difficulty() {
    let mut problem = Problem {
        model: |x, b| {
            let off = (x - b[2]) / b[1];
            let bell = (-0.5 * off * off).exp() / b[1];
            let value = b[0] * bell;
            (
                value,
                [bell, value * (off * off - 1.0) / b[1], value * off / b[1]],
            )
        },
        starts: [[1.0, 10.0, 500.0], [1.5, 5.0, 450.0]],
        values: [1.5543827178, 4.0888321754, 4.5154121844e2],
        deviations: [1.5408051163e-2, 4.6803020753e-2, 4.6800518816e-2],
        data: &[
            (0.0001575, 400.0),
            (0.0001699, 405.0),
            (0.0002350, 410.0),
            (0.0003102, 415.0),
            (0.0004917, 420.0),
            (0.0008710, 425.0),
            (0.0017418, 430.0),
            (0.0046400, 435.0),
            (0.0065895, 436.5),
            (0.0097302, 438.0),
            (0.0149002, 439.5),
            (0.0237310, 441.0),
            (0.0401683, 442.5),
            (0.0712559, 444.0),
            (0.1264458, 445.5),
            (0.2073413, 447.0),
            (0.2902366, 448.5),
            (0.3445623, 450.0),
            (0.3698049, 451.5),
            (0.3668534, 453.0),
            (0.3106727, 454.5),
            (0.2078154, 456.0),
            (0.1164354, 457.5),
            (0.0616764, 459.0),
            (0.0337200, 460.5),
            (0.0194023, 462.0),
            (0.0117831, 463.5),
            (0.0074357, 465.0),
            (0.0022732, 470.0),
            (0.0008800, 475.0),
            (0.0004579, 480.0),
            (0.0002345, 485.0),
            (0.0001586, 490.0),
            (0.0001143, 495.0),
            (0.0000710, 500.0),
        ],
    };
    // The first start is five widths away, where the data do not constrain the parameters: it is not tested.
    problem.starts[0] = problem.starts[1];
    problem.holds();
}

#[test]
fn thurber_a_cubic_over_a_cubic_of_higher_difficulty() {
    let problem = Problem {
        model: |x, b| {
            let (x2, x3) = (x * x, x * x * x);
            let above = b[0] + b[1] * x + b[2] * x2 + b[3] * x3;
            let below = 1.0 + b[4] * x + b[5] * x2 + b[6] * x3;
            let by_below = -above / (below * below);
            let by_above = 1.0 / below;
            let derivatives = [
                by_above,
                x * by_above,
                x2 * by_above,
                x3 * by_above,
                x * by_below,
                x2 * by_below,
                x3 * by_below,
            ];
            (above / below, derivatives)
        },
        starts: [
            [1000.0, 1000.0, 400.0, 40.0, 0.7, 0.3, 0.03],
            [1300.0, 1500.0, 500.0, 75.0, 1.0, 0.4, 0.05],
        ],
        values: [
            1.2881396800e3,
            1.4910792535e3,
            5.8323836877e2,
            7.5416644291e1,
            9.6629502864e-1,
            3.9797285797e-1,
            4.9727297349e-2,
        ],
        deviations: [
            4.6647963344,
            3.9571156086e1,
            2.8698696102e1,
            5.5675370270,
            3.1333340687e-2,
            1.4984928198e-2,
            6.5842344623e-3,
        ],
        data: &[
            (80.574, -3.067),
            (84.248, -2.981),
            (87.264, -2.921),
            (87.195, -2.912),
            (89.076, -2.840),
            (89.608, -2.797),
            (89.868, -2.702),
            (90.101, -2.699),
            (92.405, -2.633),
            (95.854, -2.481),
            (100.696, -2.363),
            (101.060, -2.322),
            (401.672, -1.501),
            (390.724, -1.460),
            (567.534, -1.274),
            (635.316, -1.212),
            (733.054, -1.100),
            (759.087, -1.046),
            (894.206, -0.915),
            (990.785, -0.714),
            (1090.109, -0.566),
            (1080.914, -0.545),
            (1122.643, -0.400),
            (1178.351, -0.309),
            (1260.531, -0.109),
            (1273.514, -0.103),
            (1288.339, 0.010),
            (1327.543, 0.119),
            (1353.863, 0.377),
            (1414.509, 0.790),
            (1425.208, 0.963),
            (1421.384, 1.006),
            (1442.962, 1.115),
            (1464.350, 1.572),
            (1468.705, 1.841),
            (1447.894, 2.047),
            (1457.628, 2.200),
        ],
    };
    problem.holds();
}
