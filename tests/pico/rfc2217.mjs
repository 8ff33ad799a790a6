// A serial port over TCP: Telnet with the COM port control option (RFC 2217), as far as pyserial and others use it.

const IAC = 255;
const [SE, SB, WILL, WONT, DO, DONT] = [240, 250, 251, 252, 253, 254];
const BINARY = 0;
const NO_GO_AHEAD = 3;
const COM_PORT = 44;
const OPTIONS = [BINARY, NO_GO_AHEAD, COM_PORT];
/** Commands of the client (RFC 2217, 3). The server's are greater by 100. */
const [SIGNATURE, BAUD, DATA, PARITY, STOP, CONTROL] = [0, 1, 2, 3, 4, 5];
const SERVER = 100;
/** Values of CONTROL that switch DTR; `asks` is one that wants to know, and what is answered if DTR is on or off. */
const DTR = { asks: 7, on: 8, off: 9 };
const PARITIES = { 1: 'N', 2: 'O', 3: 'E', 4: 'M', 5: 'S' };
const STOPS = { 1: '1', 2: '2', 3: '1.5' };
/** Longest subnegotiation: more than any that makes sense. */
const LONGEST = 64;

/** The server's end of one connection. */
export class ComPort {
  /**
   * @param {object} on
   * @param {(bytes: Uint8Array) => void} on.send sends to the client
   * @param {(bytes: Uint8Array) => void} on.data told what the client sends to the port
   * @param {(baud: number, format: string) => void} on.line told the line that the client sets, e.g. 9600 and `8E1`
   * @param {(isOn: boolean) => void} on.dtr told when the client switches DTR
   */
  constructor(on) {
    this.on = on;
    this.state = 'data';
    this.settings = { [BAUD]: 9600, [DATA]: 8, [PARITY]: 1, [STOP]: 1 };
    this.isDtrOn = true;
    /** What was said of each option, so that nothing is answered for ever. */
    this.said = new Set();
    for (const option of OPTIONS) {
      this.say(WILL, option);
      this.say(DO, option);
    }
  }

  /** Escapes what the port sends. */
  write(bytes) {
    this.on.send(Uint8Array.from([...bytes].flatMap((byte) => (byte === IAC ? [IAC, IAC] : [byte]))));
  }

  /** Takes what the client has sent. */
  take(bytes) {
    const data = [];
    for (const byte of bytes) this.next(byte, data);
    if (data.length) this.on.data(Uint8Array.from(data));
  }

  /** @private */
  next(byte, data) {
    switch (this.state) {
      case 'data':
        if (byte === IAC) this.state = 'command';
        else data.push(byte);
        return;
      case 'command':
        if (byte === IAC) data.push(byte);
        if (byte === SB) this.inner = [];
        this.verb = byte;
        this.state = byte === SB ? 'inner' : byte >= WILL && byte < IAC ? 'option' : 'data';
        return;
      case 'option':
        this.state = 'data';
        this.negotiate(this.verb, byte);
        return;
      case 'inner':
        if (byte === IAC) this.state = 'inner command';
        else if (this.inner.length < LONGEST) this.inner.push(byte);
        return;
      default:
        this.state = byte === SE ? 'data' : 'inner';
        if (byte === IAC) this.inner.push(byte);
        else if (byte === SE) this.command(this.inner);
    }
  }

  /** @private */
  say(verb, option) {
    const key = `${verb} ${option}`;
    if (this.said.has(key)) return;
    this.said.add(key);
    this.on.send(Uint8Array.of(IAC, verb, option));
  }

  /** @private */
  negotiate(verb, option) {
    const isKnown = OPTIONS.includes(option);
    if (verb === WILL) this.say(isKnown ? DO : DONT, option);
    if (verb === DO) this.say(isKnown ? WILL : WONT, option);
  }

  /** @private */
  command([option, command, ...values]) {
    if (option !== COM_PORT) return;
    const answer = (...bytes) => {
      const escaped = bytes.flatMap((byte) => (byte === IAC ? [IAC, IAC] : [byte]));
      this.on.send(Uint8Array.of(IAC, SB, COM_PORT, command + SERVER, ...escaped, IAC, SE));
    };
    const { settings } = this;
    const [value] = values;
    switch (command) {
      case SIGNATURE:
        if (!values.length) answer(...Buffer.from('drivetwin'));
        return;
      case BAUD: {
        if (values.length !== 4) return;
        const baud = Buffer.from(values).readUInt32BE();
        if (baud) this.set(BAUD, baud);
        const now = Buffer.alloc(4);
        now.writeUInt32BE(settings[BAUD]);
        answer(...now);
        return;
      }
      case DATA:
        if (value >= 5 && value <= 8) this.set(DATA, value);
        answer(settings[DATA]);
        return;
      case PARITY:
        if (value in PARITIES) this.set(PARITY, value);
        answer(settings[PARITY]);
        return;
      case STOP:
        if (value in STOPS) this.set(STOP, value);
        answer(settings[STOP]);
        return;
      case CONTROL:
        if (value === DTR.asks) answer(this.isDtrOn ? DTR.on : DTR.off);
        else answer(value ?? 0);
        if (value === DTR.on || value === DTR.off) {
          this.isDtrOn = value === DTR.on;
          this.on.dtr(this.isDtrOn);
        }
        return;
      default:
        // Masks of notifications, purges and flow control: nothing of them is needed here.
        if (command < SERVER) answer(...values);
    }
  }

  /** @private */
  set(what, value) {
    this.settings[what] = value;
    const { [BAUD]: baud, [DATA]: data, [PARITY]: parity, [STOP]: stop } = this.settings;
    this.on.line(baud, `${data}${PARITIES[parity]}${STOPS[stop]}`);
  }
}
