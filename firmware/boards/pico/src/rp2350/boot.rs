//! The way from the reset to a program in RAM (5.9.5): the boot ROM looks for the definition of an image in the
//! first 4 KiB of the flash, and takes the stack pointer and the start address from the first two words.

/// The smallest definition of an image (5.9.5.1): a program for Arm that runs in the secure state.
#[unsafe(link_section = ".image_def")]
#[unsafe(no_mangle)]
#[used]
static IMAGE_DEF: [u32; 5] = [0xFFFF_DED3, 0x1021_0142, 0x0000_01FF, 0, 0xAB12_3579];

drivetwin_board::run_from_ram!();
