//! A PLL (2.18; RP2350: 8.6).

use crate::registers::Register;

/// Starts a PLL that multiplies the frequency of the crystal, and divides it twice.
pub(crate) fn start_pll(pll: usize, times: u32, [first, second]: [u32; 2]) {
    const LOCKED: u32 = 1 << 31;
    let [cs, power, fbdiv, prim] = [0x0, 0x4, 0x8, 0xC].map(|offset| Register::at(pll, offset));
    cs.write(1);
    fbdiv.write(times);
    power.clear(1 << 0 | 1 << 5);
    while cs.read() & LOCKED == 0 {}
    prim.write(first << 16 | second << 12);
    power.clear(1 << 3);
}
