//! The pre-check against the parry3d oracle: prints missed collisions, blocked share and tightness.
//!
//! `cargo run -p control --release --example precheck_oracle -- [poses] [moves] [seed]`

#[path = "../tests/control/oracle.rs"]
mod oracle;
#[path = "../tests/control/study.rs"]
mod study;

fn main() {
    let mut args = std::env::args().skip(1).map(|a| {
        a.parse::<u64>()
            .expect("arguments are numbers: poses moves seed")
    });
    let poses = args.next().unwrap_or(1_000_000);
    let moves = args.next().unwrap_or(100_000);
    let seed = args.next().unwrap_or(1);
    for twist_deg in [90.0f64, 180.0] {
        println!("twist {twist_deg} deg, seed {seed}");
        let study = study::Study::new(twist_deg.to_radians(), seed);
        println!(
            "  polyhedra reach {:.3} mm short of the true shape at most",
            study.oracle.reach_m * 1e3
        );
        print!("{}", study.poses(poses, study::Where::Everywhere));
        print!("{}", study.poses(poses / 5, study::Where::Near));
        print!("{}", study.moves(moves));
    }
}
