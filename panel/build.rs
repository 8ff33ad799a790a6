//! Lets cargo see new files of the page.

fn main() {
    println!("cargo::rerun-if-changed=page");
}
