//! Every instruction and operand form of 6.9, typed from its tables and run on the drive.

use drivetwin_sim::bench::PinStimulus;
use drivetwin_tests::rs434::{LINE, Rig, at, system_register};

use crate::oracle::status;

/// A row: uCmd bTypeJmp uAdrSysReg uTypeModbusReg uData [uCMD_DATA] | registers before | registers that
/// change. All numbers are hex. A dot is a field that the instruction does not use: its bits may have any
/// value. `7` is an error of the program, which changes nothing else. END lines follow the instruction.
#[rustfmt::skip]
const TABLE: &[&str] = &[
    // END and DELAY.
    "00 . . . .               |                            | PC=0000",
    "04 . . . 0000            |                            | PC=0001",
    // JMP, absolute or relative to its own line (RS434-29). Line 1,024 does not exist.
    "05 0 . . 0005            |                            | PC=0005",
    "05 0 . . 03FF            |                            | PC=03FF",
    "05 0 . . 0400            |                            | 7",
    "05 0 . . FFFF            |                            | 7",
    "05 1 . . 0001            |                            | PC=0001",
    "05 1 . . 0005            |                            | PC=0005",
    "05 1 . . 03FF            |                            | PC=03FF",
    "05 1 . . 0400            |                            | 7",
    "05 1 . . FFFF            |                            | 7",
    // JMP_AX_PARI_BX, NOPARI, MORE, LESS. Comparisons are unsigned (RS434-32).
    "06 0 . . 0005            | AX=8000 BX=8000            | PC=0005",
    "06 1 . . 0006            | AX=0000 BX=0000            | PC=0006",
    "06 0 . . 0005            | AX=8000 BX=8001            | PC=0001",
    "06 0 . . 0400            | AX=0001 BX=0002            | PC=0001",
    "06 0 . . 0400            | AX=0001 BX=0001            | 7",
    "07 0 . . 0005            | AX=8000 BX=8001            | PC=0005",
    "07 1 . . 0006            | AX=0100 BX=0000            | PC=0006",
    "07 0 . . 0005            | AX=8000 BX=8000            | PC=0001",
    "08 0 . . 0005            | AX=8000 BX=7FFF            | PC=0005",
    "08 1 . . 0006            | AX=FFFF BX=0001            | PC=0006",
    "08 0 . . 0005            | AX=7FFF BX=8000            | PC=0001",
    "08 0 . . 0005            | AX=1234 BX=1234            | PC=0001",
    "09 0 . . 0005            | AX=7FFF BX=8000            | PC=0005",
    "09 1 . . 0006            | AX=0001 BX=FFFF            | PC=0006",
    "09 0 . . 0005            | AX=8000 BX=7FFF            | PC=0001",
    "09 0 . . 0005            | AX=1234 BX=1234            | PC=0001",
    // DJMP_GX_PARI_IX, NOPARI, MORE, LESS.
    "63 0 . . 0005            | GX=1 HX=8000 IX=1 JX=8000  | PC=0005",
    "63 1 . . 0006            | GX=0 HX=0000 IX=0 JX=0000  | PC=0006",
    "63 0 . . 0005            | GX=1 HX=8000 IX=1 JX=8001  | PC=0001",
    "63 0 . . 0005            | GX=2 HX=8000 IX=1 JX=8000  | PC=0001",
    "64 0 . . 0005            | GX=1 HX=8000 IX=1 JX=8001  | PC=0005",
    "64 1 . . 0006            | GX=2 HX=8000 IX=1 JX=8000  | PC=0006",
    "64 0 . . 0005            | GX=1 HX=8000 IX=1 JX=8000  | PC=0001",
    "65 0 . . 0005            | GX=0 HX=8000 IX=FFFF JX=7FFF | PC=0005",
    "65 1 . . 0006            | GX=2 HX=0001 IX=1 JX=0001  | PC=0006",
    "65 0 . . 0005            | GX=FFFF HX=7FFF IX=0 JX=8000 | PC=0001",
    "65 0 . . 0005            | GX=1 HX=0001 IX=1 JX=0001  | PC=0001",
    "66 0 . . 0005            | GX=FFFF HX=7FFF IX=0 JX=8000 | PC=0005",
    "66 1 . . 0006            | GX=1 HX=0001 IX=2 JX=0001  | PC=0006",
    "66 0 . . 0005            | GX=0 HX=8000 IX=FFFF JX=7FFF | PC=0001",
    "66 0 . . 0005            | GX=1 HX=0001 IX=1 JX=0001  | PC=0001",
    // CALL, RETURN without a CALL, FOR with an empty body.
    "0A . . . 0005            |                            | PC=0005",
    "0A . . . 03FF            |                            | PC=03FF",
    "0A . . . 0400            |                            | 7",
    "0B . . . .               |                            | 7",
    "0C . . . 0500            |                            | PC=0006",
    "0C . . . 0005            |                            | PC=0001",
    "0C . . . 0000            |                            | PC=0001",
    // MOV_SYSREG_CONST
    "01 . 0 . FFFF            | AX=1234                    | AX=FFFF",
    "01 . 5 . 8001            |                            | FX=8001",
    "01 . 6 . 0001            |                            | GX=0001",
    "01 . 9 . 0000            | JX=0001                    | JX=0000",
    // MOV_MODBUS_SYSREG
    "02 . 0 3 500B            | AX=0100                    | 500B=0100",
    "02 . 9 3 5012            | JX=FFF1                    | 5012=FFF1",
    "02 . 0 3 7009            | AX=0100                    | IX=0100",
    "02 . 0 3 500B            | AX=001D                    | ERROR=2000",
    "02 . 0 3 500B            | AX=3A99                    | ERROR=2000",
    "02 . 0 3 7006            | AX=0000                    | 7",
    // MOV_SYSREG_MODBUS, from each of the four spaces.
    "03 . 0 0 1000            | IN1=1 AX=5555              | AX=0001",
    "03 . 0 0 1000            | AX=5555                    | AX=0000",
    "03 . 1 0 1002            |                            | BX=0001",
    "03 . 2 1 2000            | CX=5555                    | CX=0000",
    "03 . 3 2 8001            |                            | DX=03E9",
    "03 . 4 2 3009            |                            | EX=0004",
    "03 . 5 3 500B            |                            | FX=03E8",
    "03 . 6 3 7006            | GX=5555                    | GX=0000",
    "03 . 7 3 5024            | HX=5555                    | HX=0000",
    // MOV_MODBUS_CONST. Only the low half of the second line counts.
    "0E . . 3 500B 00000064   |                            | 500B=0064",
    "0E . . 3 5012 12348000   |                            | 5012=8000",
    "0E . . 3 7000 00000007   |                            | AX=0007",
    "0E . . 3 500B 00000001   |                            | ERROR=2000",
    "0E . . 3 5004 00000003   |                            | ERROR=2000",
    "0E . . 3 5023 0000FFFF   |                            | ERROR=0000",
    "0E . . 1 2003 00000000   |                            | 2003=0000",
    // MOV_SYSREG_SYSREG, from uAdrSysReg to uData (RS434-31).
    "0F . 0 . 0001            | AX=1111 BX=2222            | BX=1111",
    "0F . 9 . 0000            | AX=1111 JX=2222            | AX=2222",
    "0F . 3 . 0003            | DX=1111                    | DX=1111",
    "0F . 0 . 000A            |                            | 7",
    "0F . 0 . 0100            |                            | 7",
    // NOT
    "15 . 0 . .               | AX=1234                    | AX=EDCB",
    "15 . 9 . .               | JX=FFFF                    | JX=0000",
    "16 . . 3 5012            | 5012=1234                  | 5012=EDCB",
    "16 . . 3 500B            | 500B=0100                  | ERROR=2000",
    "16 . . 3 7000            | AX=00FF                    | AX=FF00",
    "17 . 0 . .               | AX=1234 BX=0000            | AX=EDCB BX=FFFF",
    "17 . 5 . .               | FX=0001 GX=8000            | FX=FFFE GX=7FFF",
    "17 . 8 . .               | IX=FFFF JX=FFFF            | IX=0000 JX=0000",
    "17 . 9 . .               | JX=FFFF                    | 7",
    "18 . . 3 5015            | 5015=5555 5016=0F0F        | 5015=AAAA 5016=F0F0",
    "18 . . 3 7000            | AX=0001 BX=0002            | AX=FFFE BX=FFFD",
    "18 . . 3 7005            |                            | 7",
    "18 . . 3 700A            |                            | 7",
    // ADD, SUB, DIV, MUL, AND, OR, XOR_SYSREG_CONST
    "19 . 0 . 0005            | AX=0003                    | AX=0008",
    "19 . 5 . 0001            | FX=FFFF                    | FX=0000",
    "19 . 5 . FFFF            | FX=7FFF                    | FX=7FFE",
    "1A . 1 . 0003            | BX=0005                    | BX=0002",
    "1A . 9 . 0001            | JX=0000                    | JX=FFFF",
    "1B . 2 . 0003            | CX=0008                    | CX=0002",
    "1B . 6 . 0002            | GX=FFFE                    | GX=7FFF",
    "1B . 6 . FFFF            | GX=FFFE                    | GX=0000",
    "1B . 6 . 0000            | GX=0005                    | 7",
    "1C . 3 . 0007            | DX=0006                    | DX=002A",
    "1C . 3 . 0100            | DX=0123                    | DX=2300",
    "1C . 3 . FFFF            | DX=FFFF                    | DX=0001",
    "1D . 4 . 0FF0            | EX=1234                    | EX=0230",
    "1E . 7 . 0FF0            | HX=1234                    | HX=1FF4",
    "1F . 8 . 0FF0            | IX=1234                    | IX=1DC4",
    // SH_SYSREG_CONST, one line. 0 is left, 1 is right. A shift by 16 or more gives 0.
    "20 0 0 . 0001            | AX=8001                    | AX=0002",
    "20 0 0 . 000F            | AX=FFFF                    | AX=8000",
    "20 0 0 . 0000            | AX=8001                    | AX=8001",
    "20 0 0 . 0010            | AX=FFFF                    | AX=0000",
    "20 0 0 . FFFF            | AX=FFFF                    | AX=0000",
    "20 1 9 . 0001            | JX=8001                    | JX=4000",
    "20 1 9 . 000F            | JX=FFFF                    | JX=0001",
    "20 1 9 . 0010            | JX=FFFF                    | JX=0000",
    "20 1 9 . 0020            | JX=FFFF                    | JX=0000",
    // ..._SYSREG_MODBUS
    "21 . 0 3 500B            | AX=0001                    | AX=03E9",
    "21 . 0 0 1002            | AX=FFFF                    | AX=0000",
    "21 . 0 1 2000            | AX=1234                    | AX=1234",
    "21 . 0 2 8001            | AX=0001                    | AX=03EA",
    "22 . 1 3 500B            | BX=0000                    | BX=FC18",
    "23 . 2 3 500B            | CX=07D1                    | CX=0002",
    "23 . 2 3 5015            | CX=07D1                    | 7",
    "23 . 2 1 2003            | CX=07D1                    | 7",
    "23 . 2 0 1002            | CX=07D1                    | CX=07D1",
    "24 . 3 3 500B            | DX=0064                    | DX=86A0",
    "24 . 3 2 3009            | DX=4001                    | DX=0004",
    "25 . 4 3 500B            | EX=0FF0                    | EX=03E0",
    "26 . 5 3 500B            | FX=0013                    | FX=03FB",
    "27 . 6 3 500B            | GX=03FF                    | GX=0017",
    "27 . 6 3 7007            | GX=1234                    | GX=0000",
    // ..._MODBUS_CONST, two lines.
    "28 . . 3 500B 00000001   |                            | 500B=03E9",
    "28 . . 3 5012 0001FFFF   | 5012=0003                  | 5012=0002",
    "28 . . 3 500B 00003A98   |                            | ERROR=2000",
    "29 . . 3 500B 00000064   |                            | 500B=0384",
    "29 . . 3 500B 000003E9   |                            | ERROR=2000",
    "29 . . 3 5012 00000001   | 5012=0000                  | 5012=FFFF",
    "2A . . 3 500B 00000003   |                            | 500B=014D",
    "2A . . 3 500B 00000000   |                            | 7",
    "2A . . 3 500B 00010000   |                            | 7",
    "2A . . 3 500B 000003E8   |                            | ERROR=2000",
    "2B . . 3 500B 0000000A   |                            | 500B=2710",
    "2B . . 3 5012 00000100   | 5012=0123                  | 5012=2300",
    "2C . . 3 500B 00000FE0   |                            | 500B=03E0",
    "2D . . 3 500B 00000013   |                            | 500B=03FB",
    "2E . . 3 500B 000000FF   |                            | 500B=0317",
    "2E . . 3 7002 0000FFFF   | CX=5555                    | CX=AAAA",
    // SH_MODBUS_CONST, two lines. The second is the distance.
    "2F 0 . 3 5012 00000004   | 5012=1234                  | 5012=2340",
    "2F 0 . 3 5012 00000010   | 5012=FFFF                  | 5012=0000",
    "2F 1 . 3 5012 00000004   | 5012=1234                  | 5012=0123",
    "2F 1 . 3 5012 0001000F   | 5012=8000                  | 5012=0001",
    "2F 1 . 3 5012 00000011   | 5012=FFFF                  | 5012=0000",
    "2F 0 . 3 500B 00000004   |                            | ERROR=2000",
    // ..._MODBUS_SYSREG. The result goes to the Modbus register.
    "30 . 0 3 500B            | AX=0001                    | 500B=03E9",
    "30 . 9 3 5012            | JX=FFFF 5012=0003          | 5012=0002",
    "31 . 1 3 500B            | BX=0064                    | 500B=0384",
    "31 . 1 3 500B            | BX=FFFF                    | 500B=03E9",
    "32 . 2 3 500B            | CX=0003                    | 500B=014D",
    "32 . 2 3 500B            | CX=0000                    | 7",
    "33 . 3 3 500B            | DX=000A                    | 500B=2710",
    "33 . 3 3 500B            | DX=0000                    | ERROR=2000",
    "34 . 4 3 500B            | EX=0FE0                    | 500B=03E0",
    "35 . 5 3 500B            | FX=0013                    | 500B=03FB",
    "36 . 6 3 500B            | GX=00FF                    | 500B=0317",
    "36 . 6 3 7007            | GX=1234                    | GX=0000",
    // ..._SYSREG_SYSREG. The result goes to uAdrSysReg (RS434-31).
    "37 . 0 . 0001            | AX=FFFF BX=0002            | AX=0001",
    "37 . 9 . 0009            | JX=8001                    | JX=0002",
    "38 . 0 . 0001            | AX=0001 BX=0002            | AX=FFFF",
    "39 . 0 . 0001            | AX=FFFF BX=0010            | AX=0FFF",
    "39 . 0 . 0001            | AX=FFFF BX=0000            | 7",
    "3A . 0 . 0001            | AX=0100 BX=0100            | AX=0000",
    "3B . 2 . 0008            | CX=F0F0 IX=3C3C            | CX=3030",
    "3C . 2 . 0008            | CX=F0F0 IX=3C3C            | CX=FCFC",
    "3D . 2 . 0008            | CX=F0F0 IX=3C3C            | CX=CCCC",
    "3D . 2 . 000A            | CX=F0F0                    | 7",

    // DMOV_SYSREG_CONST
    "10 . 0 . . 12345678      |                            | AX=5678 BX=1234",
    "10 . 5 . . FFFF0001      |                            | FX=0001 GX=FFFF",
    "10 . 8 . . 80000000      | IX=0001                    | IX=0000 JX=8000",
    "10 . 9 . . 12345678      |                            | 7",
    // DMOV_SYSREG_MODBUS
    "11 . 0 3 5015            | 5015=5678 5016=1234        | AX=5678 BX=1234",
    "11 . 0 3 500A            |                            | AX=0BB8 BX=03E8",
    "11 . 8 3 7006            | GX=4321                    | IX=0000 JX=4321",
    "11 . 2 0 1000            | IN2=1                      | CX=0000 DX=0001",
    "11 . 2 0 1001            | IN2=1                      | CX=0001 DX=0001",
    "11 . 2 0 1002            |                            | 7",
    "11 . 2 1 2002            | CX=1111 DX=2222            | CX=0000 DX=0000",
    "11 . 2 1 2003            |                            | 7",
    "11 . 2 2 3003            | CX=1111 DX=2222            | CX=0000 DX=0000",
    "11 . 2 2 3009            |                            | 7",
    "11 . 2 2 8004            |                            | 7",
    "11 . 2 3 700A            |                            | 7",
    "11 . 2 3 5026            |                            | 7",
    "11 . 9 3 5015            |                            | 7",
    // DMOV_MODBUS_CONST
    "12 . . 3 5015 FFFFFFFF   |                            | 5015=FFFF 5016=FFFF",
    "12 . . 3 500B 00640190   |                            | 500B=0190 500C=0064",
    "12 . . 3 500B 00090190   |                            | ERROR=2000",
    "12 . . 3 500B 0064001D   |                            | ERROR=2000",
    "12 . . 3 7004 12345678   |                            | EX=5678 FX=1234",
    "12 . . 3 7005 12345678   |                            | 7",
    "12 . . 3 7006 12345678   |                            | 7",
    "12 . . 3 5026 00000000   |                            | 7",
    "12 . . 3 FFFF 00000000   |                            | 7",
    // DMOV_MODBUS_SYSREG
    "13 . 0 3 5015            | AX=5678 BX=1234            | 5015=5678 5016=1234",
    "13 . 5 3 5017            | FX=5678 GX=1234            | 5017=5678 5018=1234",
    "13 . 9 3 5015            |                            | 7",
    // DMOV_SYSREG_SYSREG, from uAdrSysReg to uData.
    "14 . 0 . 0008            | AX=5678 BX=1234            | IX=5678 JX=1234",
    "14 . 0 . 0001            | AX=1111 BX=2222 CX=3333    | BX=1111 CX=2222",
    "14 . 1 . 0000            | AX=1111 BX=2222 CX=3333    | AX=2222 BX=3333",
    "14 . 0 . 0009            |                            | 7",
    "14 . 9 . 0000            |                            | 7",
    // D..._SYSREG_CONST, two lines (6.9).
    "3E . 0 . . 00000001      | AX=FFFF BX=0000            | AX=0000 BX=0001",
    "3E . 0 . . 00000001      | AX=FFFF BX=FFFF            | AX=0000 BX=0000",
    "3F . 5 . . 00000001      | FX=0000 GX=0001            | FX=FFFF GX=0000",
    "3F . 5 . . 00000001      | FX=0000 GX=0000            | FX=FFFF GX=FFFF",
    "40 . 8 . . 00000010      | IX=5678 JX=1234            | IX=4567 JX=0123",
    "40 . 8 . . 00000002      | IX=FFFF JX=FFFF            | IX=FFFF JX=7FFF",
    "40 . 8 . . 00000000      | IX=5678                    | 7",
    "41 . 0 . . 00010001      | AX=0003 BX=0000            | AX=0003 BX=0003",
    "41 . 0 . . FFFFFFFF      | AX=0002 BX=0000            | AX=FFFE BX=FFFF",
    "42 . 0 . . 0FF000FF      | AX=1234 BX=5678            | AX=0034 BX=0670",
    "43 . 0 . . 0FF000FF      | AX=1234 BX=5678            | AX=12FF BX=5FF8",
    "44 . 0 . . 0FF000FF      | AX=1234 BX=5678            | AX=12CB BX=5988",
    "44 . 9 . . 0FF000FF      |                            | 7",
    // DSH_SYSREG_CONST, one line.
    "45 0 0 . 0004            | AX=5678 BX=1234            | AX=6780 BX=2345",
    "45 0 0 . 0010            | AX=5678 BX=1234            | AX=0000 BX=5678",
    "45 0 0 . 001F            | AX=0001 BX=0000            | AX=0000 BX=8000",
    "45 0 0 . 0020            | AX=5678 BX=1234            | AX=0000 BX=0000",
    "45 1 8 . 0004            | IX=5678 JX=1234            | IX=4567 JX=0123",
    "45 1 8 . 001F            | IX=0000 JX=8000            | IX=0001 JX=0000",
    "45 1 8 . FFFF            | IX=5678 JX=1234            | IX=0000 JX=0000",
    "45 1 8 . 0000            | IX=5678 JX=1234            | IX=5678 JX=1234",
    "45 1 9 . 0001            |                            | 7",
    // D..._SYSREG_MODBUS
    "46 . 0 3 5015            | AX=0001 5015=FFFF 5016=0001 | AX=0000 BX=0002",
    "46 . 0 0 1001            | AX=0001 IN2=1              | AX=0002 BX=0001",
    "46 . 0 2 3004            | AX=1234 BX=0000            | AX=1234 BX=00FA",
    "47 . 0 3 5015            | 5015=0001                  | AX=FFFF BX=FFFF",
    "48 . 0 3 5015            | AX=0000 BX=0001 5015=0100  | AX=0100 BX=0000",
    "48 . 0 3 5017            | AX=0000 BX=0001            | 7",
    "49 . 0 3 5015            | AX=0000 BX=0001 5015=0005 5016=0007 | AX=0000 BX=0005",
    "4A . 0 3 5015            | AX=FF00 BX=0FF0 5015=1234 5016=5678 | AX=1200 BX=0670",
    "4B . 0 3 5015            | AX=FF00 BX=0FF0 5015=1234 5016=5678 | AX=FF34 BX=5FF8",
    "4C . 0 3 5015            | AX=FF00 BX=0FF0 5015=1234 5016=5678 | AX=ED34 BX=5988",
    // D..._MODBUS_CONST
    "4D . . 3 5015 00000001   | 5015=FFFF                  | 5015=0000 5016=0001",
    "4D . . 3 500B 00010001   |                            | 500B=03E9 500C=0065",
    "4D . . 3 500B 0001FFFF   |                            | 500B=03E7 500C=0066",
    "4E . . 3 5015 00000001   |                            | 5015=FFFF 5016=FFFF",
    "4F . . 3 5015 00000003   | 5015=0000 5016=0001        | 5015=5555 5016=0000",
    "4F . . 3 5015 00000000   | 5015=0001                  | 7",
    "50 . . 3 5015 00010002   | 5015=0003 5016=0000        | 5015=0006 5016=0003",
    "51 . . 3 5015 0FF0FF00   | 5015=1234 5016=5678        | 5015=1200 5016=0670",
    "52 . . 3 5015 0FF0FF00   | 5015=1234 5016=5678        | 5015=FF34 5016=5FF8",
    "53 . . 3 5015 0FF0FF00   | 5015=1234 5016=5678        | 5015=ED34 5016=5988",
    // DSH_MODBUS_CONST, two lines.
    "54 0 . 3 5015 00000004   | 5015=5678 5016=1234        | 5015=6780 5016=2345",
    "54 0 . 3 5015 00000020   | 5015=5678 5016=1234        | 5015=0000 5016=0000",
    "54 1 . 3 5015 00000008   | 5015=5678 5016=1234        | 5015=3456 5016=0012",
    "54 1 . 3 5015 0000001F   | 5015=0000 5016=8000        | 5015=0001 5016=0000",
    // D..._MODBUS_SYSREG
    "55 . 0 3 5015            | AX=0001 5015=FFFF          | 5015=0000 5016=0001",
    "56 . 5 3 5015            | FX=0001                    | 5015=FFFF 5016=FFFF",
    "57 . 0 3 5015            | AX=0003 5015=0000 5016=0001 | 5015=5555 5016=0000",
    "57 . 0 3 5015            | 5015=0001                  | 7",
    "58 . 0 3 5015            | AX=0002 BX=0001 5015=0003  | 5015=0006 5016=0003",
    "59 . 0 3 5015            | AX=FF00 BX=0FF0 5015=1234 5016=5678 | 5015=1200 5016=0670",
    "5A . 0 3 5015            | AX=FF00 BX=0FF0 5015=1234 5016=5678 | 5015=FF34 5016=5FF8",
    "5B . 0 3 5015            | AX=FF00 BX=0FF0 5015=1234 5016=5678 | 5015=ED34 5016=5988",
    "5B . 9 3 5015            |                            | 7",
    // D..._SYSREG_SYSREG. The result goes to uAdrSysReg.
    "5C . 0 . 0008            | AX=FFFF BX=0000 IX=0001 JX=0000 | AX=0000 BX=0001",
    "5D . 0 . 0008            | AX=0000 BX=0000 IX=0001 JX=0000 | AX=FFFF BX=FFFF",
    "5E . 0 . 0008            | AX=0000 BX=0001 IX=0003 JX=0000 | AX=5555 BX=0000",
    "5E . 0 . 0008            | AX=0000 BX=0001            | 7",
    "5F . 0 . 0008            | AX=0003 BX=0000 IX=0002 JX=0001 | AX=0006 BX=0003",
    "60 . 0 . 0008            | AX=FF00 BX=0FF0 IX=1234 JX=5678 | AX=1200 BX=0670",
    "61 . 0 . 0008            | AX=FF00 BX=0FF0 IX=1234 JX=5678 | AX=FF34 BX=5FF8",
    "62 . 0 . 0008            | AX=FF00 BX=0FF0 IX=1234 JX=5678 | AX=ED34 BX=5988",
    "62 . 5 . 0005            | FX=1234 GX=5678            | FX=0000 GX=0000",
    "62 . 0 . 0009            |                            | 7",
];

/// Every code except 0Dh, which has its own tests because it restores more than a row can show.
#[test]
fn section_6_9_the_table_has_every_instruction() {
    let codes: Vec<u32> = TABLE.iter().map(|row| hex(&row[..2])).collect();
    for code in (0x00..=0x66).filter(|code| *code != 0x0D) {
        assert!(codes.contains(&code), "{code:02X}h");
    }
}

#[test]
fn section_6_9_every_instruction_with_zeros_in_unused_fields() {
    TABLE.iter().for_each(|row| check(row, 0));
}

#[test]
fn section_6_9_every_instruction_with_ones_in_unused_fields() {
    TABLE.iter().for_each(|row| check(row, u32::MAX));
}

fn hex(text: &str) -> u32 {
    u32::from_str_radix(text, 16).unwrap_or_else(|_| panic!("{text} is no hexadecimal number"))
}

/// The lines of an instruction. Its fields have 7, 1, 4, 4 and 16 bits from the lowest bit on (6.9).
fn lines(fields: &str, unused: u32) -> Vec<u32> {
    let fields: Vec<&str> = fields.split_whitespace().collect();
    let mut line = 0;
    for ((low, bits), field) in [(0, 7), (7, 1), (8, 4), (12, 4), (16, 16)].into_iter().zip(&fields) {
        let mask = (1 << bits) - 1;
        let value = if *field == "." { unused & mask } else { hex(field) };
        assert!(value <= mask, "{field} has more than {bits} bits");
        line |= value << low;
    }
    std::iter::once(line).chain(fields.get(5).map(|data| hex(data))).collect()
}

/// Address and value of an assignment like `AX=0001`.
fn assignment(text: &str) -> (u16, u16) {
    let (name, value) = text.split_once('=').unwrap_or_else(|| panic!("{text} assigns nothing"));
    let system = ["AX", "BX", "CX", "DX", "EX", "FX", "GX", "HX", "IX", "JX"];
    let address = match name {
        "ERROR" => at::ERROR,
        "PC" => at::PC,
        _ => match (0..).zip(system).find(|(_, known)| *known == name) {
            Some((number, _)) => system_register(number),
            None => hex(name) as u16,
        },
    };
    (address, hex(value) as u16)
}

#[track_caller]
fn check(row: &str, unused: u32) {
    let [fields, before, after] = row.split('|').collect::<Vec<_>>()[..] else { panic!("{row}") };
    let program = lines(fields, unused);
    let mut rig = Rig::default();
    rig.load(&program);
    let mut expected: Vec<(u16, u16)> = (0..10).map(|number| (system_register(number), 0)).collect();
    for given in before.split_whitespace() {
        if let Some(contact) = given.strip_suffix("=1").filter(|contact| contact.starts_with("IN")) {
            rig.drive(contact, PinStimulus::Low);
            continue;
        }
        let (address, value) = assignment(given);
        rig.write(address, value);
        expected.push((address, value));
    }
    let fails = after.trim() == "7";
    expected.push((at::ERROR, if fails { 0x0100 } else { 0 }));
    expected.push((at::PC, if fails { 0 } else { program.len() as u16 }));
    expected.push((at::STATUS_USER_PROGRAM, if fails { status::ERROR } else { status::END }));
    if !fails {
        expected.extend(after.split_whitespace().map(assignment));
    }
    rig.run();
    rig.after(LINE * 2);
    for (place, &(address, value)) in expected.iter().enumerate() {
        // If an address occurs twice, the last entry counts.
        if expected[place + 1..].iter().all(|(later, _)| *later != address) {
            let read = rig.read(address);
            assert_eq!(read, value, "{address:04X}h reads {read:04X}h and not {value:04X}h after {row}");
        }
    }
}

/// Opcodes, grouped by the fields that they use, as in the table of section 6.9.
mod with {
    /// uAdrSysReg names one register.
    pub(super) const SYSTEM: [&[u16]; 6] = [
        &[0x15],
        &[0x01, 0x19, 0x1A, 0x1B, 0x1C, 0x1D, 0x1E, 0x1F],
        &[0x03, 0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27],
        &[0x02, 0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36],
        &[0x0F, 0x37, 0x38, 0x39, 0x3A, 0x3B, 0x3C, 0x3D],
        &[0x20],
    ];
    /// uAdrSysReg names a pair of registers.
    pub(super) const PAIR: [&[u16]; 6] = [
        &[0x17],
        &[0x10, 0x3E, 0x3F, 0x40, 0x41, 0x42, 0x43, 0x44],
        &[0x11, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B, 0x4C],
        &[0x13, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5A, 0x5B],
        &[0x14, 0x5C, 0x5D, 0x5E, 0x5F, 0x60, 0x61, 0x62],
        &[0x45],
    ];
    /// The Modbus register is only read.
    pub(super) const READ: [&[u16]; 2] = [
        &[0x03, 0x21, 0x22, 0x23, 0x24, 0x25, 0x26, 0x27],
        &[0x11, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B, 0x4C],
    ];
    /// The Modbus register is written.
    pub(super) const WRITTEN: [&[u16]; 7] = [
        &[0x16, 0x18],
        &[0x0E, 0x28, 0x29, 0x2A, 0x2B, 0x2C, 0x2D, 0x2E],
        &[0x02, 0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36],
        &[0x12, 0x4D, 0x4E, 0x4F, 0x50, 0x51, 0x52, 0x53],
        &[0x13, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5A, 0x5B],
        &[0x2F],
        &[0x54],
    ];
}

/// Runs one instruction on a drive whose AX to JX and OFFSET words are 1. Returns STATUS_USER_PROGRAM, ERROR
/// and PC.
fn outcome(code: u16, system: u16, kind: u16, data: u16) -> [u16; 3] {
    let mut rig = Rig::default();
    let line = u32::from(data) << 16 | u32::from(kind << 12 | system << 8 | code);
    rig.load(&[line, 1]);
    assert_eq!(rig.try_write_all(at::AX, &[1; 6]), Ok(()));
    assert_eq!(rig.try_write_all(at::GX, &[1; 4]), Ok(()));
    assert_eq!(rig.try_write_all(at::OFFSET, &[1; 2]), Ok(()));
    rig.run();
    rig.after(LINE * 2);
    [at::STATUS_USER_PROGRAM, at::ERROR, at::PC].map(|address| rig.read(address))
}

/// Outcome of an error in line 0.
const FAILED: [u16; 3] = [status::ERROR, 0x0100, 0];

/// "Addresses of system registers 0..9". A pair needs two of them (RS434-32).
#[test]
fn section_6_9_system_registers_that_do_not_exist() {
    for (numbers, codes) in [(&[10, 15][..], &with::SYSTEM[..]), (&[9, 10, 15], &with::PAIR)] {
        for &code in codes.iter().copied().flatten() {
            // For some codes uData is another system register, for the rest an existing Modbus register.
            let data = if matches!(code, 0x0F | 0x14 | 0x37..=0x3D | 0x5C..=0x62) { 2 } else { at::OFFSET };
            assert_eq!(outcome(code, 0, 3, data)[0], status::END, "{code:02X}h");
            for &number in numbers {
                assert_eq!(outcome(code, number, 3, data), FAILED, "{code:02X}h with {number}");
            }
        }
    }
}

/// RS434-32 and RS434-33: a Modbus register that does not exist, in any space.
#[test]
fn section_6_9_modbus_registers_that_do_not_exist() {
    let missing = [(0, 0x0FFF), (0, 0x1003), (1, 0x2004), (2, 0x300A), (2, 0x8000), (3, 0x4FFF), (3, 0x5027)];
    let also = [(2, 0x5000), (0, 0x2000), (1, 0x1000), (3, 0x3000), (3, 0x6006), (3, 0x700B), (3, 0xFFFF)];
    for &code in with::READ.iter().chain(&with::WRITTEN).copied().flatten() {
        for (kind, address) in missing.into_iter().chain(also) {
            assert_eq!(outcome(code, 0, kind, address), FAILED, "{code:02X}h with {kind} {address:04X}h");
        }
        for kind in 4..16 {
            assert_eq!(outcome(code, 0, kind, 0x5015), FAILED, "{code:02X}h with space {kind}");
        }
    }
}

/// RS434-33: a register that cannot be written: inputs of both kinds, and PC.
#[test]
fn section_6_9_modbus_registers_that_cannot_be_written() {
    for &code in with::WRITTEN.iter().copied().flatten() {
        for (kind, address) in [(0, 0x1000), (2, 0x3003), (2, 0x8001), (3, 0x7006)] {
            assert_eq!(outcome(code, 0, kind, address), FAILED, "{code:02X}h with {kind} {address:04X}h");
        }
    }
}

/// RS434-33: codes that the table does not have.
#[test]
fn section_6_9_unknown_instructions() {
    for code in 0x67..=0x7F {
        assert_eq!(outcome(code, 0, 3, 0x5015), FAILED, "{code:02X}h");
    }
}
