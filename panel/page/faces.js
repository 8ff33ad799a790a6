// The fronts of the products, as their manuals label connectors and lights. A contact that the drive does not have as
// a pin has only its label. Where the manual gives no number of a contact, there is none.

const MD3 = {
  title: "MD3", maker: "US Digital",
  leds: { D6: ["Heartbeat", "green"], D5: ["Current cutback", "red"] }, // section 2
  connectors: [
    { name: "J2", title: "Signals, section 2", contacts: [
      [1, "Isolator GND"], [2, "Low current · Speedsel · Home sensor", "J2.2"], [3, "Inhibit · Home", "J2.3"],
      [4, "Step · Go-stop", "J2.4"], [5, "Dir", "J2.5"], [6, "Isolator +5 V"], [7, "+5 V out"], [8, "GND"],
      [9, "Encoder index · I/O", "J2.9"], [10, "Encoder A · I/O", "J2.10"], [11, "+5 V out"], [12, "Encoder B · I/O", "J2.12"]] },
    { name: "J3", title: "Power and motor", contacts: [
      [1, "9–50 VDC"], [2, "GND"], [3, "Phase A"], [4, "Phase A−"], [5, "Phase B"], [6, "Phase B−"],
      [7, "Busy, open drain", "J3.7"], [8, "Output bit, open drain", "J3.8"]] },
    { name: "P1", title: "RS-485", contacts: [[1, "GND"], [5, "BUS+"], [6, "BUS−"]] },
    { name: "Inside", title: "To the motor stage", contacts: [[null, "Step", "STEP"], [null, "Direction", "DIR"]] },
  ],
};

const RS = {
  title: "RS PRO", maker: "brush motor controller",
  leds: { GREEN: ["Green", "green"], RED: ["Red", "red"] },
  connectors: [
    { name: "5–8", title: "Signals, figure 2", contacts: [[5, "IN1, clean contact", "IN1"], [6, "IN2, clean contact", "IN2"], [7, "HARD STOP", "HARD_STOP"], [8, "GND"]] },
    { name: "9–12", title: "Hall sensors", contacts: [[9, "+5 V out"], [10, "Hall sensor A", "HA"], [11, "Hall sensor B", "HB"], [12, "GND"]] },
    { name: "1–4", title: "Supply", contacts: [[1, "GND"], [2, "GND"], [3, "12–24 VDC"], [4, "12–24 VDC"]] },
    { name: "13–16", title: "Motor", contacts: [[13, "A"], [14, "A"], [15, "B"], [16, "B"]] },
    { name: "RJ11", title: "RS-485 Modbus", contacts: [[1, "CLR_FLASH_CON", "CLR_FLASH"]] },
  ],
};

const MDROBOT = {
  title: "MD400", maker: "MDROBOT",
  leds: {},
  connectors: [
    { name: "CTRL", title: "Control, 11 contacts", contacts: [
      [2, "INT_SPEED", "INT_SPEED"], [null, "ALARM_RESET", "ALARM_RESET"], [null, "DIR", "DIR"], [7, "RUN/BRAKE", "RUN_BRAKE"],
      [8, "START/STOP", "START_STOP"], [10, "Speed input, 0–5 V", "SPEED_IN"], [null, "ALARM", "ALARM"]] },
    { name: "PULSE_IN", title: "Pulses", contacts: [[2, "PULSE_IN", "PULSE_IN"]] },
    { name: "Encoder", title: "", contacts: [[null, "ENC_A", "ENC_A"], [null, "ENC_B", "ENC_B"]] },
    { name: "Hall", title: "Motor's sensors", contacts: [[null, "HU", "HU"], [null, "HV", "HV"], [null, "HW", "HW"]] },
    { name: "Outputs", title: "", contacts: [[null, "CLUTCH", "CLUTCH"], [null, "FAN", "FAN"]] },
  ],
};

const MDRIVE = {
  title: "MDrive", maker: "Schneider Electric · IMS",
  leds: {},
  connectors: [
    { name: "I/O", title: "Points 1–4, general purpose", contacts: [[1, "I/O 1", "IO1"], [2, "I/O 2", "IO2"], [3, "I/O 3", "IO3"], [4, "I/O 4", "IO4"]] },
    { name: "Clock", title: "Points 7 and 8", contacts: [[7, "I/O 7, clock", "IO7"], [8, "I/O 8, clock", "IO8"]] },
    { name: "Analog", title: "Input 0–10 V, 0–20 mA", contacts: [[5, "Analog input", "ANALOG"]] },
    { name: "Capture", title: "Capture and trip", contacts: [[13, "Capture/trip I/O", "CAPTURE"]] },
    { name: "Encoder", title: "", contacts: [[null, "Channel A", "A"], [null, "Channel B", "B"], [null, "Index", "I"]] },
    { name: "Ethernet", title: "Modbus/TCP 502, MCode 503", contacts: [] },
  ],
};

const QSB = {
  title: "QSB", maker: "US Digital",
  leds: {},
  connectors: [
    { name: "Encoder", title: "", contacts: [[null, "A", "A"], [null, "B", "B"], [null, "Index", "I"], [null, "PWM, on A", "PWM"], [null, "Analog, on A", "ANALOG"]] },
    { name: "Digital I/O", title: "Motor drive: 1 step, 2 direction", contacts: [[0, "I/O bit 0", "DIO0"], [1, "I/O bit 1", "DIO1"], [2, "I/O bit 2", "DIO2"], [3, "I/O bit 3", "DIO3"]] },
    { name: "USB", title: "Serial port", contacts: [] },
  ],
};

const PRODUCTS = [[/^md3/, MD3], [/^rs/, RS], [/^mdrobot/, MDROBOT], [/^mdrive/, MDRIVE], [/^qsb/, QSB]];

/** The front of a kind. Pins that no connector names follow in one of their own, grouped by what precedes a point. */
export function faceOf(kind, pins) {
  const product = PRODUCTS.find(([pattern]) => pattern.test(kind.kind))?.[1];
  const base = product ?? { title: kind.kind, maker: kind.product, leds: {}, connectors: [] };
  const named = new Set(base.connectors.flatMap(connector => connector.contacts.map(contact => contact[2])));
  const groups = new Map();
  for (const pin of pins.filter(name => !named.has(name))) {
    const [group, number] = pin.includes(".") ? pin.split(".") : ["Pins", null];
    if (!groups.has(group)) groups.set(group, []);
    groups.get(group).push([number, number === null ? pin : "", pin]);
  }
  const connectors = base.connectors
    .map(connector => ({ ...connector, contacts: connector.contacts.filter(([, , pin]) => pin === undefined || pins.includes(pin)) }))
    .filter((connector, i) => connector.contacts.length || base.connectors[i].contacts.length === 0);
  return { ...base, connectors: [...connectors, ...[...groups].map(([name, contacts]) => ({ name, title: "", contacts }))] };
}

/** The color of a light, from its name where the product does not say. */
export const colorOf = (led, known) => known ?? ["red", "green", "yellow", "blue"].find(color => led.toLowerCase().includes(color)) ?? "amber";

/** The color of a light of a kind. */
export const ledColor = (kind, led) => colorOf(led, PRODUCTS.find(([pattern]) => pattern.test(kind))?.[1].leds[led]?.[1]);
