//! The camera against closed forms, and the real side against dumps as `fakenect-record` writes them.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use camera::depth::{self, DepthError, DepthFrame, NO_READING, Samples};
use camera::similarity::{
    SizesDiffer, gait_weight, mean_ratio, meta_fitness, ratio, repeatability,
};
use camera::{Silhouette, Solid, View, picture};
use control::linalg::{Pose, Vec3};
use control::robot::RobotModel;

fn cube_halves() -> Vec<Solid> {
    let diagonal = RobotModel::DIAGONAL;
    vec![
        Solid::half_sphere(0, Vec3::ZERO, diagonal, 0.062, 0.055),
        Solid::half_sphere(0, Vec3::ZERO, -diagonal, 0.062, 0.055),
    ]
}

fn at(x: f32, y: f32, z: f32) -> Pose {
    Pose {
        position_m: Vec3::new(x, y, z),
        ..Pose::default()
    }
}

fn view(height_m: f32) -> View {
    View::new(height_m, (0.0, 0.0), 0.0, (640, 480), 580.0).unwrap()
}

/// Two halves seen from far above make the square of the faces with its corners cut by the circle:
/// area = 4 (a sqrt(R^2 - a^2)) + 2 R^2 (pi/2 - 2 acos(a/R)) ... with half edge a and ball R.
#[test]
fn a_cube_seen_from_far_has_the_area_of_its_cut_square() {
    let (a, r) = (0.055f64, 0.062f64);
    let half_chord = (r * r - a * a).sqrt();
    let corner_angle = core::f64::consts::FRAC_PI_2 - 2.0 * libm::acos(a / r);
    let area_m2 = 4.0 * (a * half_chord) + 4.0 * 0.5 * r * r * corner_angle;
    // 1000 times farther with 1000 times the focal length: parallel projection at 2 px per mm.
    let view = View::new(1000.0, (0.0, 0.0), 0.0, (640, 480), 2.0e6).unwrap();
    let area_px = f64::from(view.render(&cube_halves(), &[Pose::default()]).area_px());
    let expected_px = area_m2 * 4.0e6;
    assert!(
        (area_px / expected_px - 1.0).abs() < 0.01,
        "{area_px} px against {expected_px}"
    );
}

#[test]
fn image_axes_and_perspective_follow_the_pinhole() {
    let view = view(2.0);
    assert_eq!(view.project(Vec3::new(0.0, 0.0, 0.0)), Some([320.0, 240.0]));
    assert_eq!(
        view.project(Vec3::new(0.5, 0.0, 0.0)),
        Some([320.0 + 145.0, 240.0])
    );
    assert_eq!(
        view.project(Vec3::new(0.0, 0.5, 1.0)),
        Some([320.0, 240.0 - 290.0])
    );
    assert_eq!(view.project(Vec3::new(0.0, 0.0, 2.0)), None);
    let turned = View::new(
        2.0,
        (0.0, 0.0),
        core::f32::consts::FRAC_PI_2,
        (640, 480),
        580.0,
    )
    .unwrap();
    let [x, y] = turned.project(Vec3::new(0.0, 0.5, 0.0)).unwrap();
    assert!((x - 465.0).abs() < 1e-3 && (y - 240.0).abs() < 1e-3);
}

#[test]
fn a_robot_out_of_sight_leaves_an_empty_frame() {
    for pose in [at(50.0, 0.0, 0.0), at(0.0, -50.0, 0.0), at(0.0, 0.0, 9.0)] {
        assert_eq!(view(2.0).render(&cube_halves(), &[pose]).area_px(), 0);
    }
    assert_eq!(view(2.0).render(&cube_halves(), &[]).area_px(), 0);
}

#[test]
fn ratios_are_the_hand_counted_ones() {
    let mut a = Silhouette::new(100, 10);
    let mut b = Silhouette::new(100, 10);
    a.fill(3, 10, 90);
    b.fill(3, 50, 100);
    b.fill(4, 0, 64);
    assert_eq!(a.overlap_and_union_px(&b), Some((40, 154)));
    assert_eq!(ratio(&a, &b), Ok(Some(40.0 / 154.0)));
    assert_eq!(ratio(&a, &Silhouette::new(99, 10)), Err(SizesDiffer));
    assert_eq!(
        ratio(&Silhouette::new(9, 9), &Silhouette::new(9, 9)),
        Ok(None)
    );
    let empty = Silhouette::new(100, 10);
    let film_a = [a.clone(), a.clone(), empty.clone()];
    let film_b = [a.clone(), b.clone()];
    assert!((mean_ratio(&film_a, &film_b, 0).unwrap() - (1.0 + 40.0 / 154.0) / 2.0).abs() < 1e-12);
    assert!((mean_ratio(&film_a, &film_b, -1).unwrap() - (1.0 + 0.0) / 2.0).abs() < 1e-12);
    assert!(mean_ratio(&film_a, &film_b, 7).is_err());
    assert!(repeatability(&[&film_a]).is_err());
    assert!((repeatability(&[&film_b, &film_b, &film_b]).unwrap() - 1.0).abs() < 1e-12);
    let f = meta_fitness(&[(gait_weight(0.06, 0.5), 0.4), (gait_weight(0.03, 1.0), 0.2)]).unwrap();
    assert!((f - 0.3).abs() < 1e-12);
    assert!(meta_fitness(&[]).is_err());
}

/// A scene at 2.27 m with the robot 11 cm closer, written the way `fakenect-record` does: little endian behind `P5`.
#[test]
fn a_recorded_depth_frame_becomes_the_rendered_silhouette() {
    let truth = view(2.27).render(&cube_halves(), &[at(0.1, -0.2, 0.055)]);
    let scene = |robot: Option<&Silhouette>| DepthFrame {
        width: 640,
        height: 480,
        raw: (0..640 * 480)
            .map(|i| match robot {
                Some(robot) if robot.get(i % 640, i / 640) => 880,
                _ if i % 97 == 0 => NO_READING,
                _ => 915 + (i % 3) as u16,
            })
            .collect(),
    };
    let mut file = b"P5 640 480 65535\n".to_vec();
    file.extend(scene(Some(&truth)).raw.iter().flat_map(|r| r.to_le_bytes()));
    let frame = depth::read_pgm(&file, Samples::LittleEndian).unwrap();
    let ground = depth::background(&[scene(None), scene(None), frame.clone()]).unwrap();
    let found = depth::silhouette(&frame, &ground, 10).unwrap();
    assert!(ratio(&found, &truth).unwrap().unwrap() > 0.98);
}

#[test]
fn bad_depth_files_are_named() {
    let cases: [(&[u8], DepthError); 5] = [
        (b"P6 1 1 255\n\0\0\0", DepthError::Magic),
        (
            b"P5 x",
            DepthError::Header {
                field: "width",
                offset: 2,
            },
        ),
        (
            b"P5 0 4 255\n",
            DepthError::Header {
                field: "width",
                offset: 10,
            },
        ),
        (
            b"P5 2 2 255\n\0\0\0",
            DepthError::Short {
                needed: 4,
                found: 3,
            },
        ),
        (
            b"P5 2 2 65535\n",
            DepthError::Short {
                needed: 8,
                found: 0,
            },
        ),
    ];
    for (bytes, error) in cases {
        assert_eq!(depth::read_pgm(bytes, Samples::BigEndian), Err(error));
    }
    let good = b"P5\n# made by hand\n2 1\n255\n\x07\x09";
    assert_eq!(
        depth::read_pgm(good, Samples::BigEndian).unwrap().raw,
        [7, 9]
    );
    assert_eq!(depth::background(&[]), Err(DepthError::NoFrame));
}

#[test]
fn a_fakenect_index_gives_depth_frames_and_times() {
    let text = "r-1325000000.10-1.ppm\nd-1325000000.123456-3355443.pgm\na-1325000000.2-2.dump\nd-x-1.pgm\n";
    let entries = depth::read_fakenect_index(text);
    assert_eq!(entries.len(), 1);
    assert_eq!(entries[0].file, "d-1325000000.123456-3355443.pgm");
    assert_eq!(entries[0].t_s, 1_325_000_000.123_456);
}

#[test]
fn pictures_read_back_and_show_the_papers_colours() {
    let robot = view(2.27).render(&cube_halves(), &[at(0.0, 0.0, 0.055)]);
    let simulated = view(2.27).render(&cube_halves(), &[at(0.03, 0.0, 0.055)]);
    let png = picture::silhouette_png(&robot).unwrap();
    assert_eq!(picture::read_silhouette_png(&png).unwrap(), robot);
    let overlay = picture::overlay_png(&robot, &simulated).unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(&overlay))
        .read_info()
        .unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut data).unwrap();
    let colours: std::collections::BTreeSet<[u8; 3]> =
        data.as_chunks::<3>().0.iter().copied().collect();
    assert_eq!(colours.len(), 4);
    let film = picture::animation_png(&[(&robot, &simulated), (&robot, &robot)], 30).unwrap();
    assert_eq!(
        png::Decoder::new(std::io::Cursor::new(&film))
            .read_info()
            .unwrap()
            .info()
            .animation_control()
            .unwrap()
            .num_frames,
        2
    );
    assert!(picture::film_strip_png(&[&robot, &robot], &[&simulated]).is_ok());
    assert!(picture::film_strip_png(&[], &[]).is_err());
    assert!(picture::read_silhouette_png(&png[..40]).is_err());
}

/// Widths that end inside a byte and inside a word, as 1-bit and as 8-bit pictures.
#[test]
fn pictures_of_any_width_read_back() {
    for width in [1, 7, 8, 63, 64, 65, 70, 130] {
        let mut frame = Silhouette::new(width, 5);
        frame.fill(1, 0, width);
        frame.fill(2, width / 3, width / 2 + 1);
        frame.fill(4, width - 1, width);
        let png = picture::silhouette_png(&frame).unwrap();
        assert_eq!(picture::read_silhouette_png(&png).unwrap(), frame);
        let mut grey = Vec::new();
        let mut encoder = png::Encoder::new(&mut grey, width as u32, 5);
        encoder.set_color(png::ColorType::Grayscale);
        let pixels = (0..5).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data: Vec<u8> = pixels
            .map(|(x, y)| if frame.get(x, y) { 128 } else { 127 })
            .collect();
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&data).unwrap();
        drop(writer);
        assert_eq!(picture::read_silhouette_png(&grey).unwrap(), frame);
    }
}

/// Lying at home the four cubes make one bar of four cut squares side by side.
#[test]
fn the_meta_module_at_home_is_a_bar_of_four_cubes() {
    let robot = RobotModel::default();
    let mut at_home = control::kinematics::forward(&robot, &[0.0; 6])
        .bodies()
        .to_vec();
    let far = View::new(1000.0, (0.165, 0.0), 0.0, (2000, 480), 2.0e6).unwrap();
    let one = far.render(&cube_halves(), &[Pose::default()]).area_px();
    for pose in &mut at_home {
        pose.position_m.z += 0.055;
    }
    let bar = far.render(&Solid::meta_module(&robot), &at_home).area_px();
    let cubes = f64::from(bar) / f64::from(one);
    assert!((3.9..=4.02).contains(&cubes), "{cubes} cubes");
}
