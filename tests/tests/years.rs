//! Ten years.

use drivetwin::{Bench, Settings, Span as _, kinds};

#[test]
fn turning() {
    for kind in kinds::ALL {
        let bench = Bench::with(Settings::default());
        let x = bench.add(kind, "x").unwrap();
        bench.advance(10.secs());
        match kind {
            "md3"|"md3-low" => { x.set("Speed", 40000).unwrap(); x.set("MotionControl", 2).unwrap(); }
            "qsb-m" => { println!("{:?}", String::from_utf8_lossy(&x.ask(b"W162\r"))); x.ask(b"W10FF\r"); x.ask(b"W165\r"); }
            "rs434544"|"rs434546" => { x.set("START_bit", 1).unwrap(); }
            "mdrobot" => { x.set("UI_COM", 1).unwrap(); x.set("VEL_CMD", 3000).unwrap(); }
            "mdrive"|"mdrive-hybrid" => { x.set("SL", 700_000).unwrap(); }
            _ => {}
        }
        let t = std::time::Instant::now();
        bench.advance(60.secs());
        println!("{kind} minute {:?} {:?}", t.elapsed(), x.motion());
        if t.elapsed().as_millis() > 50 { continue; }
        let t = std::time::Instant::now();
        bench.advance(3600.secs());
        println!("{kind} hour {:?} {:?}", t.elapsed(), x.motion());
    }
}
