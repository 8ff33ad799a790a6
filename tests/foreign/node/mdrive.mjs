// modbus-serial speaks with an MDrive over TCP: `node mdrive.mjs HOST PORT`. It ends with 0 if all is as the fieldbus
// manual says.

import assert from "node:assert/strict";
import ModbusRTU from "modbus-serial";

const [host, port] = process.argv.slice(2);
const HC = 0x29, I1 = 0x2d, MV = 0x4a, O1 = 0x4b, P = 0x57, RC = 0x67, MR = 0x46, VM = 0x8b, ER = 0x21;

const master = new ModbusRTU();
master.setTimeout(30_000);
await master.connectTCP(host, { port: Number(port) });
master.setID(1);

const words = async (address, count) => (await master.readHoldingRegisters(address, count)).data;
const refused = async (request, code) => {
    await assert.rejects(request, (error) => error.modbusCode === code, `exception ${code}`);
};

assert.deepEqual(await words(VM, 2), [0x000b, 0xb800]);
await master.writeRegisters(VM, [0x0009, 0x27c0]);
assert.deepEqual(await words(VM, 2), [0x0009, 0x27c0]);

const inputs = await master.readDiscreteInputs(I1, 4);
assert.deepEqual(inputs.data.slice(0, 4), [false, false, false, false]);
const outputs = await master.readCoils(O1, 4);
assert.equal(outputs.data.slice(0, 4).length, 4);

await refused(master.writeCoil(O1, true), 4);
assert.deepEqual(await words(ER, 1), [9]);
await refused(master.readHoldingRegisters(0x02, 1), 2);
await refused(master.readHoldingRegisters(P, 5), 3);
await refused(master.writeRegisters(RC, [101]), 3);
assert.deepEqual(await words(ER, 1), [21]);
await refused(master.writeRegister(RC, 5), 1);
await refused(master.readInputRegisters(HC, 1), 1);

const identification = await master.readDeviceIdentification(2, 0);
assert.equal(identification.data[0], "SEM USA");
assert.equal(identification.data[3], "www.imshome.com");

// One step: 2.5 ms, and then a step at VI.
await master.writeRegisters(MR, [0, 1]);
for (let moving = 1; moving; ) [moving] = await words(MV, 1);
assert.deepEqual(await words(P, 2), [0, 1]);

// Two units, and several questions under way at once.
master.setID(247);
const answers = await Promise.all(Array.from({ length: 20 }, () => words(HC, 1)));
assert.deepEqual(answers, Array(20).fill([5]));

await new Promise((done) => master.close(done));
