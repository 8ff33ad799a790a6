"""What a controller may rely on in an MD3. Registers and sections are those of its user guide."""

PINS = 0x09
MOTION_CONTROL = 0x11
MOVE_STEPS_LOW = 0x13
EEPROM_CONTROL = 0x1A
USER_REGISTER = 0x1D

MOVE = 1
"""Bit of MOTION_CONTROL (7.15)."""
SAVE = 1
"""Bit of EEPROM_CONTROL (7.20)."""
STOP_BY_PIN_3 = 2 << 8
"""While J2 pin 3 is low the bus moves nothing: INHIBIT_MODBUS_MOTION (7.8)."""


def test_a_move_takes_its_time(drive, master):
    """20,000 steps at 5,000 steps/s and 10,000 steps/s²: half a second up, 3.5 s, half a second down."""
    master.write_register(MOVE_STEPS_LOW, 20_000)
    master.write_register(MOTION_CONTROL, MOVE)
    drive.advance(2.25)
    half_way = drive.motion()
    assert half_way["moving"] and half_way["speed"] == 5_000
    assert abs(half_way["position"] - 10_000) < 100
    assert master.read_holding_registers(MOTION_CONTROL).registers == [MOVE]
    drive.advance(2.25)
    at_the_end = drive.motion()
    assert (at_the_end["position"], at_the_end["moving"]) == (20_000, False)
    assert master.read_holding_registers(MOTION_CONTROL).registers == [0]


def test_a_limit_switch_stops_it(drive, master):
    master.write_register(PINS, STOP_BY_PIN_3)
    master.write_register(MOTION_CONTROL, MOVE)
    drive.advance(1.0)
    drive.pin("J2.3", "low")
    stopped = drive.motion()
    assert 0 < stopped["position"] < 10_000 and not stopped["moving"]
    master.write_register(MOTION_CONTROL, MOVE)
    drive.advance(1.0)
    assert drive.motion() == stopped


def test_what_was_saved_outlives_the_power(drive, master):
    master.write_register(USER_REGISTER, 1234)
    master.write_register(EEPROM_CONTROL, SAVE)
    drive.advance(0.1)
    master.write_register(USER_REGISTER, 5678)
    drive.power_cycle()
    drive.advance(0.1)
    assert master.read_holding_registers(USER_REGISTER).registers == [1234]
