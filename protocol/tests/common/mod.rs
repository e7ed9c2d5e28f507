//! Shared by the tests: one of every message, a module that records what it is told, an 8N1 wire.
#![allow(
    dead_code,
    unused_imports,
    unreachable_pub,
    missing_docs,
    reason = "every test binary uses its part"
)]

mod told;

pub use told::{event_kinds, faults, rejects};

use heapless::{String, Vec};
use protocol::bus::PackedFeedback;
use protocol::bus::Profile;
use protocol::link::*;

pub const KEY: Key = Key([0x4B; KEY_LEN]);
pub const NONCE: Nonce = Nonce([0x11; NONCE_LEN]);
pub const BOOT: u32 = 0xB007_1D00;
pub const ROBOT: u8 = 7;

pub fn gait() -> WireGait {
    let mut gait = WireGait {
        name: String::try_from("crawl").unwrap(),
        frequency_hz: 0.2,
        rate_a_per_s: 2.0,
        duration_s: 30.0,
        ..WireGait::default()
    };
    for k in 0..6 {
        let amplitude_rad = 0.5 + 0.1 * k as f32;
        gait.oscillators
            .push(WireOscillator {
                amplitude_rad,
                offset_rad: -0.25,
                initial_phase_rad: 0.0,
            })
            .unwrap();
    }
    for k in 0..5 {
        gait.links
            .push(WireLink {
                from: k,
                to: k + 1,
                weight: 0.5,
                phase_lag_rad: 1.5,
            })
            .unwrap();
    }
    gait
}

/// The largest gait there can be.
pub fn largest_gait() -> WireGait {
    let mut gait = WireGait {
        name: String::try_from("01234567890123456789012345678901").unwrap(),
        frequency_hz: f32::from_bits(0xFFFF_FFFF),
        rate_a_per_s: 1.0e-30,
        duration_s: -0.0,
        ..WireGait::default()
    };
    while !gait.oscillators.is_full() {
        gait.oscillators
            .push(WireOscillator {
                amplitude_rad: 3.3,
                offset_rad: -3.3,
                initial_phase_rad: 1.7,
            })
            .unwrap();
    }
    while !gait.links.is_full() {
        gait.links
            .push(WireLink {
                from: 255,
                to: 255,
                weight: 0.7,
                phase_lag_rad: -1.7,
            })
            .unwrap();
    }
    gait
}

pub fn feedback(seed: i32) -> PackedFeedback {
    PackedFeedback {
        tick_4us: (seed * 12_500) as u16,
        applied_urad: 100_000 * seed - 7,
        position_urad: -90_000 * seed,
        velocity: (seed * 311) as i16,
        current_ma: (seed * 40) as i16 - 100,
        duty: (seed * 100) as i16,
        voltage_5mv: 1480,
        temperature_c: 25,
        status: 3,
        boots: 1,
    }
}

pub fn sample(seed: i32) -> Sample {
    let mut sample = Sample {
        cycle: seed as u32,
        t_us: 1_000_000 + 50_000 * seed as u64,
        flags: 2,
        valid_mask: 0x3F,
        ..Sample::of(6)
    };
    for (k, motor) in (0..).zip(&mut sample.motors) {
        *motor = MotorSample {
            dt_us: 400 + 300 * k as u32,
            setpoint_urad: 100_000 * seed - 7,
            feedback: feedback(seed + k),
        };
    }
    sample
}

pub fn to_module() -> std::vec::Vec<ToModule> {
    let tag = Tag::NONE;
    vec![
        ToModule::Hello { protocol: 1 },
        ToModule::GetInfo,
        ToModule::GetChallenge,
        ToModule::PutGait {
            slot: 2,
            activate: true,
            gait: gait(),
            tag,
        },
        ToModule::GetGait { slot: 2 },
        ToModule::ListSlots,
        ToModule::ActivateSlot { slot: 2, tag },
        ToModule::EraseSlot { slot: 3, tag },
        ToModule::Start {
            slot: 2,
            digest: Digest([1, 2, 3, 4, 5, 6, 7, 8]),
            duration_ms: 30_000,
            rate: TelemetryRate::Cycle,
            countdown_ms: 3000,
            tag,
        },
        ToModule::Stop,
        ToModule::ClearFault { tag },
        ToModule::Zero {
            joint_mask: 0x3F,
            tag,
        },
        ToModule::Ping {
            host_t_us: 1_700_000_000_000_000,
        },
        ToModule::Subscribe {
            rate: TelemetryRate::Fast,
        },
        ToModule::GetEvents { since: 300 },
        ToModule::Drain { from_sample: 128 },
        ToModule::BusRaw {
            bytes: Vec::from_slice(&[0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x01, 0x19, 0x4E])
                .unwrap(),
            listen_ms: 20,
            tag,
        },
        ToModule::SetKey { key: KEY },
        ToModule::Reset { tag },
        ToModule::GetCrash,
        ToModule::StartTethered {
            slot: 2,
            digest: Digest([1, 2, 3, 4, 5, 6, 7, 8]),
            duration_ms: 30_000,
            rate: TelemetryRate::Cycle,
            countdown_ms: 3000,
            lease_ms: 1000,
            tag,
        },
        ToModule::Heartbeat { tag },
        ToModule::ProveState { nonce: NONCE },
        ToModule::ChangeGait {
            slot: 1,
            digest: Digest([1, 2, 3, 4, 5, 6, 7, 8]),
            tag,
        },
        ToModule::SetDrivers {
            profile: Profile::Xm430,
            tag,
        },
        ToModule::GetDrivers,
        ToModule::SetRobot {
            robot: robot(2),
            tag,
        },
        ToModule::GetRobot,
    ]
}

pub fn robot(joints: usize) -> WireRobot {
    WireRobot {
        contact: WireContact::Unchecked,
        speeds_rad_s: (0..joints).map(|_| 2.0).collect(),
    }
}

pub const WRONG_DRIVER: WrongDriver = WrongDriver {
    joint: 2,
    model: 777,
    address: 0,
};

pub fn hello() -> Hello {
    Hello {
        protocol: 1,
        robot_id: ROBOT,
        boot_id: BOOT,
        firmware: String::try_from("rb 0.1.0+abc1234").unwrap(),
        model_digest: Digest([9; 8]),
        keyed: true,
    }
}

pub fn info() -> Info {
    Info {
        state: ModuleState::Idle,
        fault: Some(FaultInfo {
            fault: Fault::DriverError {
                joint: 4,
                bits: 0x20,
            },
            first_us: 77,
            count: 2,
        }),
        reset_cause: ResetCause::Watchdog,
        slots: 4,
        active_slot: Some(2),
        battery_mv: 7400,
        homed_mask: 0x3F,
        motor_mask: 0x2F,
        uptime_us: 90_000_000,
        cycles: 1800,
        counters: Counters {
            overruns: 3,
            holds: 200,
            ..Counters::default()
        },
    }
}

pub fn from_module() -> std::vec::Vec<FromModule> {
    let event = Event {
        seq: 300,
        t_us: 5_000_000,
        kind: EventKind::MotorLost { joint: 3 },
    };
    let mut log = SampleLog::<2>::new();
    log.begin(9, 6);
    log.push(&sample(1));
    log.push(&sample(2));
    log.flush();
    let mut two = SampleLog::<2>::new();
    two.begin(9, 2);
    two.push(&sample(1));
    two.flush();
    vec![
        FromModule::Hello(hello()),
        FromModule::Info(info()),
        FromModule::Challenge { nonce: NONCE },
        FromModule::Ack { request: 9 },
        FromModule::Nack {
            request: 8,
            reason: Reject::NotHomed { missing_mask: 1 },
        },
        FromModule::GaitStored {
            slot: 2,
            digest: gait().digest(),
            active: true,
        },
        FromModule::GaitData {
            slot: 2,
            digest: gait().digest(),
            gait: gait(),
        },
        FromModule::Slots {
            active: Some(0),
            slots: Vec::from_slice(&[
                Some(SlotInfo {
                    name: gait().name,
                    digest: gait().digest(),
                    generation: 5,
                }),
                None,
            ])
            .unwrap(),
        },
        FromModule::Sample(sample(3)),
        FromModule::SampleBlock(log.drain(0, true)),
        FromModule::Event(event),
        FromModule::RunEnd(RunEnd {
            run: 9,
            reason: EndReason::Fault(Fault::Stall { joint: 1 }),
            cycles: 600,
            holds: 4,
            samples: 600,
            dropped: 1,
            setpoint_crc32c: 0xDEAD_BEEF,
        }),
        FromModule::Pong {
            host_t_us: 1,
            module_t_us: 2,
        },
        FromModule::BusReply {
            status: BusStatus::Heard,
            bytes: Vec::from_slice(&[0xFF, 0x00, 0x55]).unwrap(),
        },
        FromModule::Crash(Some(CrashRecord {
            kind: CrashKind::HardFault,
            uptime_us: 12,
            pc: 0x0800_1234,
            lr: 0x0800_4321,
            detail: 0x0001_0000,
            place: String::try_from("src/app.rs").unwrap(),
        })),
        FromModule::Events {
            next: 301,
            lost: 2,
            events: Vec::from_slice(&[event]).unwrap(),
        },
        FromModule::State {
            state: ModuleState::Stopping,
            uptime_us: 90_000_000,
            tag: Tag([7; TAG_LEN]),
        },
        FromModule::Drivers {
            profile: Profile::Sts,
            wrong: Vec::from_slice(&[WRONG_DRIVER]).unwrap(),
        },
        FromModule::SampleOf(Sample {
            valid_mask: 0x81,
            motors: sample(3).motors.into_iter().take(2).collect(),
            ..sample(3)
        }),
        FromModule::SampleBlockOf(two.drain(0, true)),
        FromModule::Robot(robot(3)),
    ]
}

pub fn host_header(sequence: u16) -> Header {
    Header {
        version: VERSION,
        source: SOURCE_HOST,
        sequence,
        boot_id: BOOT,
    }
}

pub fn module_header(sequence: u16) -> Header {
    Header {
        version: VERSION,
        source: ROBOT,
        sequence,
        boot_id: BOOT,
    }
}

pub fn frame<M: Message>(header: &Header, message: &M) -> std::vec::Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let len = encode(header, message, &mut out).unwrap();
    out[..len].to_vec()
}

/// Bytes to line levels: start bit, eight data bits from the lowest, stop bit. Idle is high.
pub fn bits_of(bytes: &[u8]) -> std::vec::Vec<bool> {
    let mut bits = std::vec::Vec::with_capacity(bytes.len() * 10);
    for byte in bytes {
        bits.push(false);
        bits.extend((0..8).map(|bit| byte >> bit & 1 == 1));
        bits.push(true);
    }
    bits
}

/// Line levels to bytes as a UART does it: waits for a low, takes eight bits, drops the byte if the stop bit is low and waits for high again.
pub fn bytes_of(bits: &[bool], out: &mut std::vec::Vec<u8>) {
    out.clear();
    let mut at = 0;
    while at < bits.len() {
        if bits[at] {
            at += 1;
            continue;
        }
        let data = (0..8).fold(0, |byte, bit| {
            byte | u8::from(bits.get(at + 1 + bit).copied().unwrap_or(true)) << bit
        });
        let stop = bits.get(at + 9).copied().unwrap_or(true);
        at += 10;
        if stop {
            out.push(data);
        } else {
            while at < bits.len() && !bits[at] {
                at += 1;
            }
        }
    }
}

/// Small deterministic generator (xorshift64*), for sampling only.
pub struct Rng(pub u64);

impl Rng {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }
}
