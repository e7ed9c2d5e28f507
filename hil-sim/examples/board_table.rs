//! probe
use hil_sim::board::{elf::Elf, stack};
fn main() {
    let b = std::fs::read(std::env::args().nth(1).unwrap()).unwrap();
    let e = Elf::parse(&b).unwrap();
    for s in &e.sections {
        println!("{s:?}");
    }
    println!("{:#?}", stack::bound(&e));
    let mut f: Vec<_> = stack::frames(&e).into_values().collect();
    f.sort_by_key(|f| std::cmp::Reverse(f.bytes));
    for f in f.iter().take(12) {
        println!("{} {}", f.bytes, f.name);
    }
}
