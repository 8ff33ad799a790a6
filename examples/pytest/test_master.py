from pymodbus.client import ModbusSerialClient


def test_speed(twin):
    x = twin("md3", name="x", fast_boot=True)
    with ModbusSerialClient(x.url(), baudrate=9600, parity="E") as master:
        assert not master.write_register(0x15, 9000).isError()
    assert x.registers["Speed"] == 9000
