// Reads a register of an MDrive twice, and prints what came of each: the value, or the error.

import ModbusRTU from "modbus-serial";

const [host, port, address] = process.argv.slice(2);
const client = new ModbusRTU();
await client.connectTCP(host, { port: Number(port) });
client.setID(1);
for (const timeout of [150, 30_000]) {
  client.setTimeout(timeout);
  try {
    console.log((await client.readHoldingRegisters(Number(address), 1)).data[0]);
  } catch (error) {
    console.log(error.modbusCode === undefined ? error.errno ?? error.name : `exception ${error.modbusCode}`);
  }
}
client.close(() => {});
