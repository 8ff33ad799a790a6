//! Random slews and moves, compared with a model that computes in steps of 10 µs.

use proptest::prelude::*;

use super::*;

const STEP: f64 = 10e-6;

#[derive(Clone, Copy, Debug)]
enum Aim {
    Speed(f64),
    Position(f64),
}

/// Model of a body that accelerates with A and decelerates with D. Its speed is below VI only if that is
/// commanded.
struct Model {
    x: f64,
    v: f64,
    aim: Aim,
    settings: Settings,
}

impl Model {
    fn step(&mut self) {
        let Settings { start, speed, up, down, .. } = self.settings;
        let (vi, vm, up, down) =
            (f64::from(start), f64::from(speed), f64::from(up) * STEP, f64::from(down) * STEP);
        let before = self.v;
        match self.aim {
            Aim::Speed(aim) => {
                let least = vi.min(aim.abs());
                let turns = aim == 0.0 || self.v * aim < 0.0;
                self.v = if turns && self.v.abs() - down <= vi {
                    aim.signum() * if aim == 0.0 { 0.0 } else { least }
                } else if turns {
                    self.v - self.v.signum() * down
                } else if self.v == 0.0 {
                    aim.signum() * least
                } else if self.v.abs() < aim.abs() {
                    aim.signum() * (self.v.abs() + up).min(aim.abs())
                } else {
                    aim.signum() * (self.v.abs() - down).max(aim.abs())
                };
            }
            Aim::Position(aim) => {
                let left = (aim - self.x).abs();
                let way = (aim - self.x).signum();
                let size = self.v.abs().max(vi);
                let brakes = (size * size - vi * vi) / (2.0 * down / STEP) >= left;
                let size = if brakes { (size - down).max(vi) } else { (size + up).min(vm) };
                self.v = way * size;
                if size * STEP >= left {
                    (self.x, self.v, self.aim) = (aim, 0.0, Aim::Speed(0.0));
                    return;
                }
            }
        }
        self.x += (before + self.v) / 2.0 * STEP;
    }

    fn stands(&self) -> bool {
        self.v == 0.0 && matches!(self.aim, Aim::Speed(0.0))
    }
}

#[derive(Clone, Copy, Debug)]
enum Does {
    Slews(i32),
    Stops,
    Moves(i32),
}

fn does() -> impl Strategy<Value = Does> {
    prop_oneof![
        (-12_000..12_000_i32).prop_map(Does::Slews),
        Just(Does::Stops),
        (-4_000..4_000_i32).prop_map(Does::Moves),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn it_goes_as_the_model_does(
        start in 50..2_000_u32, more in 1..10_000_u32, up in 2_000..200_000_u32, down in 2_000..200_000_u32,
        orders in proptest::collection::vec((does(), 1..700_u64), 1..8),
    ) {
        let settings = Settings { start, speed: start + more, up, down, ..FACTORY };
        let mut bench = Bench::new(settings);
        let mut model = Model { x: 0.0, v: 0.0, aim: Aim::Speed(0.0), settings };
        let mut fastest = 0.0_f64;
        // Number of commands since both stood at the same position.
        let mut commands = 0.0;
        for (order, ms) in orders {
            commands += 1.0;
            model.v = bench.v().into();
            let mut differ = 0;
            let mut is_close = true;
            // One step of the model on the steeper ramp is several on the flatter ramp. Motion may reverse
            // that much earlier or later.
            let turn = 2 * (up.max(down) / up.min(down));
            let mut run = |bench: &mut Bench, model: &mut Model, commands: f64, steps: u64| {
                for _ in 0..steps {
                    let before = model.v;
                    model.step();
                    fastest = fastest.max(model.v.abs());
                    bench.run(10.micros());
                    // When a command arrives, the model has the speed that the drive shows, in whole steps/s. The
                    // flatter ramp makes up for this difference in the time `late`, and by so much their reversals
                    // are apart, and the steeper ramps after them; also by a step of the model on the steeper ramp.
                    let (steep, flat) = (f64::from(up.max(down)), f64::from(up.min(down)));
                    let late = 1.0 / flat;
                    let near = STEP * steep * (3.0 + steep / flat) + 1.0 + late * steep;
                    // At each end of a ramp the position may be off by a step of the model. A steep ramp that ends a
                    // step of the model later begins the flat ramp so much faster, and the stop is further by this
                    // speed's part of the flat ramp. A stop is at a whole step. Each command may add such a ramp and
                    // such a stop.
                    let off = (f64::from(bench.c1()) - model.x).abs();
                    let each = 1.0 + STEP * steep / flat * fastest;
                    let beside =
                        2.0 + f64::from(turn) * STEP * f64::from(start) + late * model.v.abs() + commands * each;
                    prop_assert!(off <= beside, "{} at {} ms: {} and {}", off, bench.ms(), bench.c1(), model.x);
                    let (low, high) = (model.v.min(before), model.v.max(before));
                    // At VI a small fraction of a step may take long.
                    let stands = bench.v() == 0 || model.v == 0.0;
                    is_close = (f64::from(bench.v()) - model.v).abs() <= 3.0 * STEP * steep + 1.0;
                    let differs = !stands && !(low - near..=high + near).contains(&f64::from(bench.v()));
                    differ = if differs { differ + 1 } else { 0 };
                    prop_assert!(differ <= 4 + turn + (late / STEP) as u32, "at {} ms: {} and {}", bench.ms(), bench.v(), model.v);
                }
                Ok(differ == 0 && is_close)
            };
            match order {
                Does::Slews(speed) => {
                    bench.does(Order::Slew(speed));
                    model.aim = Aim::Speed(speed.into());
                }
                Does::Stops => {
                    bench.does(Order::Slew(0));
                    model.aim = Aim::Speed(0.0);
                }
                Does::Moves(distance) if model.stands() && !bench.is_moving() => {
                    bench.does(by(distance));
                    run(&mut bench, &mut model, commands, 250)?;
                    model.x = bench.c1().into();
                    commands = 1.0;
                    model.aim = Aim::Position(f64::from(bench.c1() + distance));
                }
                Does::Moves(_) => {}
            }
            let mut agree = run(&mut bench, &mut model, commands, 100 * ms)?;
            // If only one of the two has reversed yet, or reversed later, a new command would mean different motions.
            while !agree {
                agree = run(&mut bench, &mut model, commands, 1)?;
            }
        }
    }
}
