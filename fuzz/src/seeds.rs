//! First inputs: the files of the repository and one of every message.

use std::path::Path;

use protocol::link::{Digest, Tag, TelemetryRate, ToModule, WireGait};

/// The inputs that fuzzing of a target begins with.
#[must_use]
pub fn of(target: &str) -> Vec<Vec<u8>> {
    let files = |folder: &str| {
        crate::corpus::folder(
            &Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("..")
                .join(folder),
        )
    };
    match target {
        "gait" => files("gaits")
            .into_iter()
            .chain(files("gaits/searched"))
            .collect(),
        "model" => vec![files::model::Model::hand_tuned().to_toml().into_bytes()],
        "structure" => files("robots"),
        "scenario" => texts(SCENARIOS),
        "dataset" => texts(MANIFESTS),
        "csv" => texts(CSV),
        "index" => texts(&[
            "t_s,file\n0,00000.png\n0.0333,00001.png\n",
            "t_s,file\n-1e3,a/b.png\n",
        ]),
        "picture" => vec![
            b"\x02\0\0\0\x08\0\0\0\x02\x01\0\0\0\0\0\0\0\xff\0\x55".to_vec(),
            b"\x02\0\0\0\x02\0\0\0\x02\x08\0\0\0\0\0\0\0\x01\x02\0\x03\x04".to_vec(),
            b"\x01P5\n2 1\n65535\n\x01\x02\x03\x04".to_vec(),
        ],
        "mcap" => mcap(),
        "bus" => vec![
            vec![0, 1, 1, 132, 4, 1, 1, 3, 132, 0, 4, 0],
            vec![
                1, 2, 6, 1, 2, 3, 4, 5, 6, 4, 0xFE, 8, 0, 4, 19, 0, 1, 2, 3, 4,
            ],
        ],
        "servos" => SERVOS.iter().map(|input| input.to_vec()).collect(),
        "link" => orders()
            .iter()
            .map(|order| [&[0, order[0], (order.len() - 1) as u8][..], &order[1..]].concat())
            .collect(),
        "robot" => robot(),
        "flash" => vec![
            vec![1, 0, 3, 4, 1, 2, 3, 4, 2, 0, 7, 3],
            vec![2, 0, 0, 4, 9, 9, 9, 9, 6, 0, 4, 1, 2, 3, 4, 1, 17, 0, 2, 0],
            vec![3, 5, 4, 2, 0, 1, 4, 1, 2, 3, 4, 2, 0, 0, 1, 2, 5, 6],
        ],
        _ => Vec::new(),
    }
}

/// Profiles of two drivers, then packets: ping, torque, a goal and a Sync Read of either framing, a registered write, other bauds.
const SERVOS: &[&[u8]] = &[
    &[
        1, 3, 0, 1, 0, 0, 0, 1, 2, 3, 64, 0, 1, 0, 1, 2, 6, 116, 0, 0, 8, 0, 0, 0, 0xFE, 9, 6, 132,
        0, 4, 0, 1, 2,
    ],
    &[
        4, 5, 3, 1, 1, 0, 3, 1, 3, 2, 40, 1, 3, 1, 3, 7, 42, 0, 8, 0, 0, 0, 0, 3, 0xFE, 0x82, 4,
        56, 2, 1, 2,
    ],
    &[
        4, 4, 3, 1, 4, 3, 42, 0, 4, 3, 0xFE, 5, 0, 3, 1, 6, 0, 3, 1, 8, 0, 3, 2, 3, 2, 6, 3,
    ],
    &[
        0, 2, 7, 1, 0, 7, 2, 1, 132, 4, 7, 1, 3, 2, 1, 2, 7, 2, 4, 50, 0, 1, 3, 5, 64, 0, 1, 0, 1,
        0xFE, 4, 0,
    ],
    &[
        2, 0, 6, 0, 0, 1, 0, 0, 6, 2, 1, 0xFE, 12, 5, 1, 132, 0, 4, 0, 2, 0xFE, 14, 5, 2, 132, 0,
        4, 0, 5, 0, 3, 0xFF, 0xFF, 0xFD,
    ],
];

fn texts(texts: &[&str]) -> Vec<Vec<u8>> {
    texts.iter().map(|text| text.as_bytes().to_vec()).collect()
}

const SCENARIOS: &[&str] = &[
    "format = 1\nname = \"a\"\nseed = 3\n[[effect]]\neffect = \"coulomb_friction\"\njoint = 2\ntorque_nm = 0.4\n",
    "format = 1\nbody = \"ground\"\n[camera]\nheight_m = 2.2\n[start]\nx_m = 0.1\n",
    "format = 1\n[bus]\ndrop = 0.01\n[[fault]]\nkind = \"stall\"\njoint = 1\nfrom_s = 2\n",
];
const MANIFESTS: &[&str] = &[
    "format = 1\nrobot = \"bench\"\nname = \"a\"\n[signals]\nsetpoint_rad = \"s\"\n[bench]\ncommand = \"position\"\nmotion = \"rotary\"\n\
     inertia_kg_m2 = { value = 0.0049, tolerance = 0.1 }\nsupply_v = { value = 7.4, tolerance = 0.05 }\n[bench.controller]\nkind = \"p\"\nkp = 1.0\n\
     period_s = 0.001\n[[run]]\nfile = \"a.csv\"\ngait = \"g\"\nrole = \"fit\"\nbench.controller.kp = 4.0\n",
    "format = 1\nrobot = \"metamodule\"\n[metamodule]\nmodel = \"model.toml\"\n[camera]\nheight_m = 2.2\nrate_hz = 30\n[[run]]\nfile = \"a.mcap#2\"\n\
     frames = \"film\"\n",
];
const CSV: &[&str] = &[
    "0t_s,setpoint_rad_0,position_rad_0,duty_0,bus_v\n0,0,0,0,7.4\n0.05,0.1,,0.2,7.3\n0.1,0.2,0.15,0.1,7.4\n",
    "1t_s,setpoint_rad,position_rad,current_a,enable\n0,0,0,0.1,1\n0.01,0.1,0.05,-0.1,0\n",
    "2t_s,s,position_m,effort_n\n0,0,0,1\n0.01,0.001,0.0005,2\n",
];

/// Every order that moves or changes something, as type byte and payload.
fn orders() -> Vec<Vec<u8>> {
    let tag = Tag::NONE;
    let gait = files::gait::parse("f", include_str!("../../gaits/first-move.toml"))
        .expect("a gait of ours");
    let gait = WireGait::from(&gait);
    let digest: Digest = gait.digest();
    let rate = TelemetryRate::Cycle;
    let start = ToModule::Start {
        slot: 0,
        digest,
        duration_ms: 3000,
        rate,
        countdown_ms: 0,
        tag,
    };
    let tethered = ToModule::StartTethered {
        slot: 0,
        digest,
        duration_ms: 3000,
        rate,
        countdown_ms: 0,
        lease_ms: 500,
        tag,
    };
    let messages = [
        ToModule::Zero {
            joint_mask: 0x3F,
            tag,
        },
        ToModule::PutGait {
            slot: 0,
            activate: true,
            gait,
            tag,
        },
        start,
        tethered,
        ToModule::Hello { protocol: 1 },
        ToModule::GetInfo,
        ToModule::GetChallenge,
        ToModule::GetGait { slot: 0 },
        ToModule::ListSlots,
        ToModule::EraseSlot { slot: 3, tag },
        ToModule::ChangeGait {
            slot: 0,
            digest,
            tag,
        },
        ToModule::Subscribe {
            rate: TelemetryRate::Fast,
        },
        ToModule::GetEvents { since: 0 },
        ToModule::Drain { from_sample: 0 },
        ToModule::ClearFault { tag },
        ToModule::Stop,
    ];
    messages.iter().filter_map(postcard_bytes).collect()
}

fn postcard_bytes(message: &ToModule) -> Option<Vec<u8>> {
    let mut buffer = [0; 1024];
    postcard::to_slice(message, &mut buffer)
        .ok()
        .map(|b| b.to_vec())
}

/// Zero, upload, start, and one more order each in the run.
fn robot() -> Vec<Vec<u8>> {
    let orders = orders();
    let block =
        |order: &Vec<u8>| [&[0, order[0], (order.len() - 1) as u8][..], &order[1..]].concat();
    let begin: Vec<u8> = orders[..3].iter().flat_map(block).collect();
    let after = |order| [&[1][..], &begin, &[15, 60], &block(order), &[15, 100]].concat();
    orders.iter().map(after).collect()
}

/// A recording of two samples' worth of records around one chunk.
fn mcap() -> Vec<Vec<u8>> {
    vec![
        b"\x02\x01\x08\x04\0\0\0ros2\x03\x10\x01\0\x01\0\0\0a\x01\0\0\0b\0\0\0\0\x02\0".to_vec(),
        b"\x03\x05\x10\x01\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0".to_vec(),
    ]
}
