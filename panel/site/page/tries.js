// The buttons of each product: title, what will happen, and what the bench is asked for, in that order.
//
// `master` gives steps to the master of the drive, one message after the other; the others are calls of the control API.

const write = (write, value) => ({ write, value });
const read = read => ({ read });
const say = say => ({ say });
const wait = wait => ({ wait });
const master = (...steps) => drive => ["POST", "master", { drive, steps }];
const power = action => drive => ["POST", `drives/${drive}/power`, { action }];
const turn = (counts, hz) => drive => ["POST", `drives/${drive}/encoder`, { counts, hz }];
const lose = (drop, port) => drive => ["PUT", `buses/${drive}.${port}/faults`, drop ? { drop } : {}];
/** Switches the power on, so long after the drive has taken a write of this register. */
const onAfter = (register, after_ms) => drive => ["POST", "scenario", { steps: [{ when: { drive, register }, after_ms, drive, power: "on" }] }];
const again = (count, ...steps) => Array.from({ length: count }, () => steps).flat();

/**
 * By the first letters of a kind: {name, title, says, calls}. `undo` has the calls of a second press, while the port `bus` loses
 * frames. `end` is the message at which the story of a button ends, and its meaning. The master comes first in `calls`: if it refuses
 * because it waits, nothing else may happen.
 */
export const TRIES = {
  md3: [
    { name: "move", title: "Move 10,000 steps", says: "The master writes the distance, then Move. The motor ramps up, runs and ramps down in 2.5 s.",
      calls: [master(write("MoveSteps", 10_000), write("MotionControl", 1))] },
    { name: "home", title: "Home", says: "The motor looks for its home switch at J2.2, backward, and stops where the switch closes.",
      calls: [master(write("HomingConfiguration", 0x10), write("MotionControl", 4))] },
    { name: "lose", title: "Lose a third of the frames", says: "The line loses each frame with a chance of one in three, until a second press. The master repeats each request that has no answer.",
      calls: [master(...again(8, read("MotionControl"))), lose(0.33, "rs485")], undo: [lose(0, "rs485")], bus: "rs485" },
    { name: "cut", title: "Cut the power in the save", says: "The power fails while the drive saves, and is back after 2 s. The master waits 11 s, and then reads in EEPROMControl that the memory is spoiled.",
      calls: [master(write("UserRegister", 4711), write("EEPROMControl", 1), wait(11), read("EEPROMControl")), power("cut"), onAfter("UserRegister", 2500)],
      end: { text: `EEPROMControl = ${0xf100}`, means: "0xF1 in the high byte: the CRC is wrong, the memory is spoiled" } },
    { name: "refuse", title: "Write where nobody may", says: "The master writes a register that is read only. The drive refuses, and the traffic says why.",
      calls: [master(write("Reserved", 5))] },
  ],
  qsb: [
    { name: "turn", title: "Turn the encoder", says: "One turn of an encoder with 500 lines, by hand: 2,000 counts in a second.", calls: [turn(2000, 2000)] },
    { name: "stream", title: "Stream", says: "The master sends S0E. The QSB then sends its count by itself, ten times a second.",
      calls: [master(write("IntervalRate", 51), say("S0E"))] },
    { name: "stop", title: "End the stream", says: "The master reads the count once with R0E, which ends the stream.", calls: [master(say("R0E"))] },
    { name: "refuse", title: "Ask for what is not there", says: "The master reads register 7F, which a QSB does not have. It answers with an error.", calls: [master(say("R7F"))] },
  ],
  rs434: [
    { name: "run", title: "Run the program", says: "The master starts the program in the drive's memory: five speeds up and down again, then backward.",
      calls: [master(write("MODE_USER_PROGRAM", 2))] },
    { name: "stop", title: "End the program", says: "The master ends the program and stops the motor.", calls: [master(write("MODE_USER_PROGRAM", 1), write("STOP_bit", 1))] },
    { name: "lose", title: "Lose a third of the frames", says: "The line loses each frame with a chance of one in three, until a second press. The master repeats each request that has no answer.",
      calls: [master(...again(8, read("SPEED_VALID"))), lose(0.33, "rs485")], undo: [lose(0, "rs485")], bus: "rs485" },
    { name: "refuse", title: "Ask for too much", says: "The master writes a speed of 20,000 rpm. The drive takes 30 to 15,000, and refuses.", calls: [master(write("SPEED", 20_000))] },
  ],
  mdrobot: [
    { name: "run", title: "Run at 1,500 rpm", says: "The master takes control, writes the speed and starts the motor, which ramps up in half a second.",
      calls: [master(write("UI_COM", 1), write("COM_TAR_SPEED", 1500), write("START_STOP", 1))] },
    { name: "reverse", title: "Reverse", says: "The master writes START_STOP = 2: down to zero, and up the other way.",
      calls: [master(write("UI_COM", 1), write("COM_TAR_SPEED", 1500), write("START_STOP", 2))] },
    { name: "stop", title: "Stop", says: "The master writes START_STOP = 0, and the motor slows down to a standstill.", calls: [master(write("START_STOP", 0))] },
    { name: "lose", title: "Lose a third of the frames", says: "The line loses each frame with a chance of one in three, until a second press. The master repeats each request that has no answer.",
      calls: [master(...again(8, read("RPM_DATA"))), lose(0.33, "rs485")], undo: [lose(0, "rs485")], bus: "rs485" },
  ],
  mdrive: [
    { name: "move", title: "Turn once", says: "The master writes MR = 51,200 by Modbus/TCP: as many steps forward, one turn of the motor.", calls: [master(write("MR", 51_200))] },
    { name: "back", title: "Back to 0", says: "The master writes MA = 0: the motor goes to position 0.", calls: [master(write("MA", 0))] },
    { name: "slew", title: "Turn on and on", says: "The master writes SL = 100,000 steps/s: two turns a second.", calls: [master(write("SL", 100_000))] },
    { name: "stop", title: "Stop", says: "The master writes SL = 0: the motor slows down and stops.", calls: [master(write("SL", 0))] },
    { name: "refuse", title: "Ask for too much", says: "The master writes RC = 200 %, a run current that is not possible. The drive refuses.", calls: [master(write("RC", 200))] },
  ],
};
