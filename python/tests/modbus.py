"""Modbus RTU frames, typed by hand from the specification."""


def crc(frame):
    """The frame with its CRC (Modbus over serial line, 6.2.2)."""
    register = 0xFFFF
    for byte in frame:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ 0xA001 if register & 1 else register >> 1
    return frame + register.to_bytes(2, "little")


def read(address, register, count):
    return crc(bytes([address, 3]) + register.to_bytes(2, "big") + count.to_bytes(2, "big"))


def write(address, register, value):
    return crc(bytes([address, 6]) + register.to_bytes(2, "big") + value.to_bytes(2, "big"))
