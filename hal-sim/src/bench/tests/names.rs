//! What lines are called.

use super::*;

fn toy(bench: &mut Bench, name: &str) -> Seat {
    bench.add::<Toy>(name)
}

#[test]
fn a_line_of_one_drive_has_two_names() {
    let mut bench = Bench::new();
    let x = md3(&mut bench, "x", 1);
    let line = bench.bus(x, RS485);
    assert_eq!(bench.bus_name(line.unwrap()), "rs485");
    assert_eq!((bench.find_bus("rs485"), bench.find_bus("x.rs485")), (line, line));
    assert_eq!((bench.find_bus("x"), bench.find_bus("usb")), (None, None));
    let usb = toy(&mut bench, "t");
    assert_eq!(bench.bus_name(line.unwrap()), "x.rs485");
    assert_eq!((bench.find_bus("rs485"), bench.find_bus("x.rs485")), (line, line));
    assert_eq!(bench.find_bus("usb"), bench.bus(usb, toy::USB));
}

#[test]
fn the_name_of_a_port_is_none_where_several_have_it() {
    let mut bench = Bench::new();
    let [x, y] = [md3(&mut bench, "x", 1), md3(&mut bench, "y", 2)];
    assert_eq!(bench.find_bus("rs485"), None);
    assert_eq!(bench.find_bus("y.rs485"), bench.bus(y, RS485));
    let line = bench.share("line1", &[(y, RS485)]);
    assert_eq!((bench.find_bus("rs485"), bench.find_bus("y.rs485")), (bench.bus(x, RS485), None));
    assert_eq!((bench.find_bus("line1"), bench.bus_name(line)), (Some(line), "line1"));
}

#[test]
fn a_shared_line_may_be_called_as_a_port_is() {
    let mut bench = Bench::new();
    let [x, y, _] = [("x", 1), ("y", 2), ("z", 3)].map(|(name, address)| md3(&mut bench, name, address));
    let line = bench.share("rs485", &[(x, RS485), (y, RS485)]);
    assert_eq!(bench.find_bus("rs485"), Some(line));
}

#[test]
#[should_panic(expected = "there are two lines called line1")]
fn two_shared_lines_have_two_names() {
    let mut bench = Bench::new();
    let [x, y] = [md3(&mut bench, "x", 1), md3(&mut bench, "y", 2)];
    bench.share("line1", &[(x, RS485)]);
    bench.share("line1", &[(y, RS485)]);
}
