//! The boot loader of a board: `flash`. Tests with a disk are in `host/src/boot_loader.rs`.

use crate::running::{Scratch, refused};

#[test]
fn what_is_no_image_for_a_pico_is_refused_before_a_board_is_looked_for() {
    let scratch = Scratch::new("flash");
    let file = scratch.file("drive.elf");
    std::fs::write(&file, b"\x7FELF").unwrap();
    assert_eq!(refused(&["flash", "pico", "--image", &file]), format!("{file} is not a UF2"));
    let missing = scratch.file("none.uf2");
    let said = refused(&["flash", "pico", "--image", &missing]);
    assert_eq!(said, format!("{missing}: No such file or directory (os error 2)"));
    let said = refused(&["flash", "uno"]);
    assert!(said.starts_with("invalid value 'uno' for '<BOARD>' [possible values: pico, pico2]"), "{said}");
}
