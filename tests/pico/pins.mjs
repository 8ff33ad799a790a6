// The levels on the pins, which rp2040js leaves to whoever drives them: it knows no pull resistors, an output does
// not read back its own level, inputs are disabled after reset, and every call counts as an edge.

import { GPIOPinState } from 'rp2040js';

const INPUT_ENABLE = 1 << 6;
const LEVEL_LOW = 1 << 0;
const LEVEL_HIGH = 1 << 1;
const NAMES = { [GPIOPinState.Low]: 'low', [GPIOPinState.High]: 'high' };

/** What a pin's multiplexer must select for UART0 (RP2040 datasheet 2.19.2), and on which pins. */
const UART = 2;
const UART0_TX = [0, 12, 16, 28];
const UART0_RX = [1, 13, 17, 29];

/** The pins of one chip, and what the world does to them. */
export class Pins {
  /**
   * @param {object} chip the emulated RP2040
   * @param {Map<number, boolean>} driven what the world drives: pin number to level; a pin that is not in it floats
   * @param {(line: string) => void} say told when the chip changes what it drives, e.g. `pin 3 high`
   */
  constructor(chip, driven, say) {
    this.chip = chip;
    this.driven = driven;
    for (const pin of chip.gpio) {
      // The reset value in the datasheet (2.19.6.3) has the input enabled.
      pin.padValue = 0x16 | INPUT_ENABLE;
      pin.addListener((now, before) => {
        const name = NAMES[now] ?? (before in NAMES ? 'float' : undefined);
        if (name) say(`pin ${pin.index} ${name}`);
        this.update(pin);
      });
      this.seen(pin);
      pin.checkForUpdates();
      this.update(pin);
      pin.irqStatus = pin.inputValue ? LEVEL_HIGH : LEVEL_LOW;
    }
  }

  /** The world drives a pin (0 to 29) differently than before. */
  changed(number) {
    this.update(this.chip.gpio[number]);
  }

  /** Whether UART0's transmitter is connected to a pin. */
  get transmits() {
    return UART0_TX.some((number) => this.chip.gpio[number].functionSelect === UART);
  }

  /** Whether UART0's receiver is connected to a pin. */
  get receives() {
    return UART0_RX.some((number) => this.chip.gpio[number].functionSelect === UART);
  }

  /** @private Lets rp2040js see a level only where the chip sees an edge. */
  seen(pin) {
    const { setInputValue } = pin;
    let before = false;
    pin.setInputValue = function (level) {
      this.rawInputValue = level;
      const now = level && this.inputEnable;
      if (now !== before) setInputValue.call(this, level);
      before = now;
    };
  }

  /** @private */
  update(pin) {
    pin.setInputValue(this.level(pin));
  }

  /** @private */
  level(pin) {
    if (pin.outputEnable) return pin.outputValue;
    if (this.driven.has(pin.index)) return this.driven.get(pin.index);
    if (pin.pullupEnabled && pin.pulldownEnabled) return pin.rawInputValue;
    return pin.pullupEnabled;
  }
}
