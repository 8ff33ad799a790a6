//! Names of drives, lines and motors.

use drivetwin_firmware::motor::stepper::StepperParameters;

use super::*;

fn toy(bench: &mut Bench, name: &str) -> DriveId {
    bench.add::<TestDevice>(name)
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
    assert_eq!(bench.find_bus("usb"), bench.bus(usb, test_device::USB));
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
#[should_panic(expected = "the name line1 is in use already")]
fn two_shared_lines_have_two_names() {
    let mut bench = Bench::new();
    let [x, y] = [md3(&mut bench, "x", 1), md3(&mut bench, "y", 2)];
    bench.share("line1", &[(x, RS485)]);
    bench.share("line1", &[(y, RS485)]);
}

#[test]
#[should_panic(expected = "the name x is in use already")]
fn a_line_is_not_called_as_a_drive_is() {
    let mut bench = Bench::new();
    let x = md3(&mut bench, "x", 1);
    bench.share("x", &[(x, RS485)]);
}

#[test]
#[should_panic(expected = "\"x.rs485\" is not a valid name for a line")]
fn a_shared_line_is_not_called_as_a_drives_own() {
    let mut bench = Bench::new();
    md3(&mut bench, "x", 1);
    let y = md3(&mut bench, "y", 2);
    bench.share("x.rs485", &[(y, RS485)]);
}

#[test]
fn drives_lines_and_motors_share_one_list_of_names() {
    let mut bench = Bench::new();
    let [x, y] = [md3(&mut bench, "x", 1), md3(&mut bench, "y", 2)];
    bench.share("line1", &[(x, RS485), (y, RS485)]);
    let stepper = || MotorModel::Stepper(StepperParameters::NOMINAL);
    bench.attach_motor("m", x, Axis(0), stepper()).unwrap();
    for name in ["x", "line1", "m"] {
        assert!(bench.is_taken(name));
        let error = format!("the name {name} is in use already");
        let drive = bench.add_with(name, Box::new(Md3::new()), Setup::default());
        assert_eq!(drive, Err(AddError::Taken(name.to_owned())));
        assert_eq!(drive.unwrap_err().to_string(), error);
        assert_eq!(bench.attach_motor(name, y, Axis(0), stepper()), Err(error));
    }
    // The name of a drive's own line is not in the list, because no other name may have a dot.
    assert!(!bench.is_taken("x.rs485") && !bench.is_taken("rs485"));
    let drive = bench.add_with("x.rs485", Box::new(Md3::new()), Setup::default());
    assert_eq!(drive, Err(AddError::Name("x.rs485".to_owned())));
    let error = "\"x.rs485\" is not a valid name for a motor: use one word without dots".to_owned();
    assert_eq!(bench.attach_motor("x.rs485", y, Axis(0), stepper()), Err(error));
}
