//! Protocol version 1, byte by byte. **If a test here fails, do not change the test**: the wire has changed, and hosts and modules in the field no longer
//! understand each other. Undo the change; add a variant at the end of an enum instead (and its bytes at the end of the table here), or begin version 2.

use crate::common::*;
use protocol::link::*;

/// Whole frames of a host: version 1, source 0, sequence 0x0102, boot id 0xB0071D00.
const TO_MODULE: &[(&str, &str)] = &[
    ("Hello", "000201030201041d07b00601022c4bb100"),
    ("GetInfo", "000201030201091d07b001e2cabcf400"),
    ("GetChallenge", "000201030201091d07b0021639ece700"),
    (
        "PutGait",
        "000201030201111d07b003020105637261776ccdcc4c3e010102400104f041060101023f010380be010101059a99193f\
         010380be010101053333333f010380be01010105cdcc4c3f010380be010101056666663f010380be010101010103803f\
         010380be010101020502010101023f0105c03f01020101023f0105c03f02030101023f0105c03f03040101023f0105c0\
         3f04050101023f0103c03f01010101010101010101010101010105b525ae1900",
    ),
    ("GetGait", "0002010302010a1d07b004022abe91ec00"),
    ("ListSlots", "000201030201091d07b005fd5d263300"),
    (
        "ActivateSlot",
        "000201030201061d07b00602010101010101010101010101010101057b7cb13700",
    ),
    (
        "EraseSlot",
        "000201030201061d07b00703010101010101010101010101010101050fa23c6700",
    ),
    (
        "Start",
        "000201030201141d07b008020102030405060708b0ea0101b8170101010101010101010101010101010504d02d3900",
    ),
    ("Stop", "000201030201091d07b0092d92657e00"),
    (
        "ClearFault",
        "000201030201051d07b00a010101010101010101010101010101053ef6787200",
    ),
    (
        "Zero",
        "000201030201061d07b00b3f01010101010101010101010101010105d27c8d9e00",
    ),
    ("Ping", "000201030201111d07b00c8080f9c0c1c482038898496100"),
    ("Subscribe", "0002010302010a1d07b00d02e5e5276200"),
    ("GetEvents", "0002010302010b1d07b00eac0247f358ff00"),
    ("Drain", "0002010302010b1d07b00f8001abd35ce500"),
    (
        "BusRaw",
        "000201030201091d07b0100afffffd0301030501194e1401010101010101010101010101010105aaa2584400",
    ),
    (
        "SetKey",
        "000201030201291d07b0114b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b4b582b857f00",
    ),
    (
        "Reset",
        "000201030201051d07b01201010101010101010101010101010105e191966a00",
    ),
    ("GetCrash", "000201030201091d07b0137a7dd90500"),
    (
        "StartTethered",
        "000201030201161d07b014020102030405060708b0ea0101b817e8070101010101010101010101010101010540aafded00",
    ),
    (
        "Heartbeat",
        "000201030201051d07b015010101010101010101010101010101058df2c4f000",
    ),
    (
        "ProveState",
        "000201030201191d07b01611111111111111111111111111111111c4a1c36900",
    ),
    (
        "ChangeGait",
        "0002010302010e1d07b01701010203040506070801010101010101010101010101010105967a599900",
    ),
    (
        "SetDrivers",
        "000201030201061d07b0180301010101010101010101010101010105369ffbc600",
    ),
    ("GetDrivers", "000201030201091d07b01942553b6e00"),
    (
        "SetRobot",
        "000201030201071d07b01a0202010102400101024001010101010101010101010101010105a837528300",
    ),
    ("GetRobot", "000201030201071d07b01bb525028f00"),
];

/// Whole frames of module 7, otherwise as above.
const FROM_MODULE: &[(&str, &str)] = &[
    (
        "Hello",
        "000501070201041d07b026010780ba9c800b10726220302e312e302b61626331323334090909090909090901f9e83cd2\
         00",
    ),
    (
        "Info",
        "0005010702011a1d07b00102010204204d0203040102e8393f2f8095f52a880e0101010101010101010101010403c801\
         0105fce5185b00",
    ),
    (
        "Challenge",
        "000501070201191d07b00211111111111111111111111111111111351877d600",
    ),
    ("Ack", "0005010702010a1d07b003094e1215c800"),
    ("Nack", "0005010702010c1d07b0040812010934625d00"),
    (
        "GaitStored",
        "000501070201131d07b005024fc9e6e26150c519019fce42d500",
    ),
    (
        "GaitData",
        "000501070201181d07b006024fc9e6e26150c51905637261776ccdcc4c3e010102400104f041060101023f010380be01\
         0101059a99193f010380be010101053333333f010380be01010105cdcc4c3f010380be010101056666663f010380be01\
         0101010103803f010380be010101020502010101023f0105c03f01020101023f0105c03f02030101023f0105c03f0304\
         0101023f0105c03f04050101023f0107c03f652862c200",
    ),
    (
        "Slots",
        "000501070201061d07b0070112020105637261776c4fc9e6e26150c5190505ff52bb4700",
    ),
    (
        "Sample",
        "000501070201a21d07b00803b09846023f9003b2cf24fca402b2cf24dffa20ca0e28d804c80b320301bc05b2cf24d086\
         03f2e930fff82bb81378a006c80b320301e807b2cf24a4e803b2843d9ff736a618c801e807c80b320301940ab2cf24f8\
         49f29e49bff541941d9802b009c80b320301c00cb2cf24ccab01b2b955dff34c8222e802f80ac80b320301ec0eb2cf24\
         a08d02f2d361fff157f026b803c00cc80b3203013dbfde7d00",
    ),
    (
        "SampleBlock",
        "000501070201061d07b0090902020499020402590711f9ff3f8ab90b2037dd21c934fcff20030104ff0fb901061038e8\
         ff65010104fe1f03011160ff3f6e110160dc9c0721d3f0ff630901082089f0ff811a0606c0ff8f545a0b38a5d08725d3\
         f0ff630901082089f0ff811a0606c0ff8f4d700b78b8c37f20320dff3f960101079208ff1fa8610112fcff686408809f\
         8943fed0641afe7f2c0101072411fe3f50c30106f8fff187130c7f941ef61f8c4cc3ff8f2501088024c2ff076a180113\
         395003fcff1d8d0180ffdcc11ffa7f1259010110fcff7cab0180ffdcc11ffa7fb33a010110fcffdbc90180ffdcc11ffa\
         7f541c01010ffcff3ae80180ffdcc11ffa7ff5fd01010ffcff99060280ffdcc11ffa7f96df01010ffcfff8240280ffdc\
         c11ffa7f37c101010105c24164d900",
    ),
    ("Event", "000501070201111d07b00aac02c096b1020b03429d1e5300"),
    (
        "RunEnd",
        "000501070201181d07b00b09050401d80404d80401effdb6f50df79b554f00",
    ),
    ("Pong", "0005010702010b1d07b00c01023b0d388f00"),
    ("BusReply", "000501070201051d07b00d0303ff0655dabb4ea600"),
    (
        "Crash",
        "000501070201221d07b00e01010cb4a48040a18681408080040a7372632f6170702e7273e0ba534e00",
    ),
    (
        "Events",
        "000501070201151d07b00fad020201ac02c096b1020b03a1d158ba00",
    ),
    (
        "State",
        "0005010702011e1d07b010058095f52a070707070707070707070707070707071103c86f00",
    ),
    ("Drivers", "0005010702010a1d07b0110401028906055571cd2a00"),
    (
        "SampleOf",
        "000501070201411d07b01203b09846028101029003b2cf24fca402b2cf24dffa20ca0e28d804c80b320301bc05b2cf24d08603f2e930fff82bb81378a006c80b3203012fcfa24000",
    ),
    (
        "SampleBlockOf",
        "000501070201061d07b0130902010402440802b21222f2ff7f147301406eba439269f8ff41060105fe1f7201062070d0ffcb010104fc3f060111c0fe7fdc2202c0b8390f42a6e1ffc71201084012e1ff03350c0105fb49e47300",
    ),
    (
        "Robot",
        "000501070201071d07b01402030101024001010240010106400214df8100",
    ),
];

/// Payloads of `Nack`, request 0, with every reason.
const REJECTS: &[(&str, &str)] = &[
    ("Version { theirs: 2, ours: 1 }", "00000201"),
    ("UnknownType { kind: 99 }", "000163"),
    ("Malformed", "0002"),
    ("TrailingBytes", "0003"),
    ("OtherSession", "0004"),
    ("BadTag", "0005"),
    ("NoChallenge", "0006"),
    ("NoKey", "0007"),
    ("WirePortOnly", "0008"),
    ("Busy", "0009"),
    ("State { state: Run }", "000a04"),
    ("NoSuchSlot { slots: 4 }", "000b04"),
    ("SlotEmpty", "000c"),
    ("SlotActive", "000d"),
    (
        "OtherGait { stored: Digest([1, 1, 1, 1, 1, 1, 1, 1]) }",
        "000e0101010101010101",
    ),
    (
        "Gait(OutOfRange { field: PhaseLag, index: 3, value: 9.0, min: -6.25, max: 6.25 })",
        "000f000703000010410000c8c00000c840",
    ),
    ("Gait(NoOscillators)", "000f01"),
    ("Gait(Name)", "000f02"),
    ("Gait(SelfLink { link: 1 })", "000f0301"),
    (
        "Gait(LinkOutOfRange { link: 1, oscillator: 7, count: 6 })",
        "000f04010706",
    ),
    ("Gait(DuplicateLink { link: 2, earlier: 1 })", "000f050201"),
    (
        "Gait(JointCount { oscillators: 5, joints: 6 })",
        "000f060506",
    ),
    (
        "Gait(TooFast { joint: 1, needed_rad_s: 3.0, limit_rad_s: 2.0 })",
        "000f07010000404000000040",
    ),
    ("Duration { max_ms: 3600000 }", "001080dddb01"),
    ("Countdown { max_ms: 30000 }", "0011b0ea01"),
    ("NotHomed { missing_mask: 63 }", "00123f"),
    ("MotorsMissing { missing_mask: 1 }", "001301"),
    (
        "Collision { body_a: 0, body_b: 6, clearance_um: -1500 }",
        "00140006b717",
    ),
    (
        "Battery { battery_mv: 6000, needed_mv: 6600 }",
        "0015f02ec833",
    ),
    ("Storage { fault: Write }", "001600"),
    ("Storage { fault: ReadBack }", "001601"),
    ("Storage { fault: Damaged }", "001602"),
    ("Latched(DriverLost { joint: 0 })", "00170000"),
    ("Latched(DriverReset { joint: 1 })", "00170101"),
    ("Latched(DriverError { joint: 2, bits: 4 })", "0017020204"),
    ("Latched(EncoderJump { joint: 3 })", "00170303"),
    ("Latched(Stall { joint: 4 })", "00170404"),
    ("Latched(EchoMismatch { joint: 5 })", "00170505"),
    ("Latched(BusLost)", "001706"),
    ("Latched(Overrun)", "001707"),
    ("Latched(LowBattery)", "001708"),
    ("Latched(GaitCorrupt)", "001709"),
    ("Latched(BadSetPoint)", "00170a"),
    ("Latched(Internal)", "00170b"),
    ("EStopLatched", "0018"),
    ("NoFault", "0019"),
    ("StopInputActive", "001a"),
    ("JointMask", "001b"),
    ("NoSamples", "001c"),
    ("BusOrder", "001d"),
    ("Unsupported", "001e"),
    ("Lease { min_ms: 100, max_ms: 60000 }", "001f64e0d403"),
    ("NotTethered", "0020"),
    ("NoEntropy", "0021"),
    (
        "WrongDriver(WrongDriver { joint: 2, model: 777, address: 0 })",
        "002202890600",
    ),
    ("TooManyTags { wait_ms: 125 }", "00237d"),
    ("Held { link: 1 }", "002401"),
    ("Robot(JointCount { joints: 0 })", "00250000"),
    ("Robot(WrongCount { joints: 5, expected: 6 })", "0025010506"),
    (
        "Robot(Speed { joint: 11, value_rad_s: 0.0 })",
        "0025020b00000000",
    ),
    ("ContactUnstated", "0026"),
    ("NotHomed { missing_mask: 4095 }", "0012ff1f"),
];

/// Payloads of `Event`, number 0 at time 0, of every kind.
const EVENTS: &[(&str, &str)] = &[
    ("Boot { cause: PowerOn }", "00000000"),
    ("Boot { cause: BrownOut }", "00000001"),
    ("Boot { cause: Pin }", "00000002"),
    ("Boot { cause: Watchdog }", "00000003"),
    ("Boot { cause: Software }", "00000004"),
    ("Boot { cause: Crash }", "00000005"),
    ("Boot { cause: Unknown }", "00000006"),
    ("State { from: Boot, to: Boot }", "0000010000"),
    ("State { from: Boot, to: Unhomed }", "0000010001"),
    ("State { from: Boot, to: Idle }", "0000010002"),
    ("State { from: Boot, to: Armed }", "0000010003"),
    ("State { from: Boot, to: Run }", "0000010004"),
    ("State { from: Boot, to: Stopping }", "0000010005"),
    ("State { from: Boot, to: Fault }", "0000010006"),
    ("State { from: Boot, to: EStop }", "0000010007"),
    (
        "GaitStored { slot: 1, digest: Digest([2, 2, 2, 2, 2, 2, 2, 2]) }",
        "000002010202020202020202",
    ),
    ("SlotActivated { slot: 1 }", "00000301"),
    ("SlotErased { slot: 1 }", "00000401"),
    (
        "RunStarted { slot: 1, digest: Digest([2, 2, 2, 2, 2, 2, 2, 2]) }",
        "000005010202020202020202",
    ),
    ("RunEnded { reason: Completed }", "00000600"),
    ("RunEnded { reason: Stopped }", "00000601"),
    ("RunEnded { reason: StopInput }", "00000602"),
    ("RunEnded { reason: ApproachBlocked }", "00000603"),
    ("RunEnded { reason: ArmTimeout }", "00000604"),
    ("RunEnded { reason: Fault(Overrun) }", "0000060507"),
    (
        "Fault(FaultInfo { fault: BusLost, first_us: 300, count: 1 })",
        "00000706ac0201",
    ),
    ("FaultCleared", "000008"),
    (
        "Hold { body_a: 1, body_b: 5, clearance_um: 3000, ahead_ms: 950 }",
        "0000090105f02eb607",
    ),
    ("HoldEnded { cycles: 12 }", "00000a0c"),
    ("MotorLost { joint: 1 }", "00000b01"),
    ("MotorFound { joint: 1 }", "00000c01"),
    ("MotorReset { joint: 1 }", "00000d01"),
    ("MotorError { joint: 1, bits: 32 }", "00000e0120"),
    ("Homed { mask: 63 }", "00000f3f"),
    ("Unhomed { mask: 1 }", "00001001"),
    ("Overrun { cycle_us: 61000 }", "000011c8dc03"),
    ("LinkSilent", "000012"),
    ("LinkBack", "000013"),
    ("BadTag { request: 3 }", "00001403"),
    ("KeySet", "000015"),
    ("BatteryLow { battery_mv: 6500 }", "000016e432"),
    (
        "SetpointMismatch { joint: 1, sent_urad: 5, applied_urad: -5 }",
        "000017010a09",
    ),
    ("Stop { input: true }", "00001801"),
    ("RunEnded { reason: HostLost }", "00000606"),
    ("Repeated { count: 40, first: 300 }", "00001928ac02"),
    (
        "GaitChanged { slot: 1, digest: Digest([2, 2, 2, 2, 2, 2, 2, 2]) }",
        "00001a010202020202020202",
    ),
    ("PortError { port: 2, fault: Overrun }", "00001b0200"),
    ("PortError { port: 2, fault: Noise }", "00001b0201"),
    ("PortError { port: 2, fault: Closed }", "00001b0202"),
    (
        "WrongDriver(WrongDriver { joint: 2, model: 777, address: 0 })",
        "00001c02890600",
    ),
    ("DriversChanged { profile: Scs }", "00001d05"),
    ("KeyReadable", "00001e"),
    (
        "RobotChanged { joints: 12, contact: Unstated }",
        "00001f0c03",
    ),
    ("Homed { mask: 4095 }", "00000fff1f"),
];

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &str) -> Vec<u8> {
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}

fn payload(message: &FromModule) -> Vec<u8> {
    let mut decoder = Decoder::new();
    let bytes = frame(&module_header(0), message);
    bytes
        .iter()
        .find_map(|byte| decoder.push(*byte).map(|frame| frame.payload().to_vec()))
        .unwrap()
}

/// Encodes to the golden bytes, and the golden bytes decode to it.
fn check<M: Message + PartialEq + std::fmt::Debug>(
    header: Header,
    messages: &[M],
    golden: &[(&str, &str)],
) {
    assert_eq!(
        messages.len(),
        usize::from(M::COUNT),
        "every message has its bytes here"
    );
    assert_eq!(messages.len(), golden.len());
    for (kind, (message, (name, text))) in (0..).zip(messages.iter().zip(golden)) {
        assert_eq!(message.kind(), kind, "{name}");
        assert_eq!(hex(&frame(&header, message)), *text, "{name}");
        let mut decoder = Decoder::new();
        let decoded = unhex(text).iter().find_map(|byte| {
            decoder
                .push(*byte)
                .map(|frame| (frame.header, frame.kind(), frame.decode::<M>()))
        });
        let (got_header, got_kind, got) = decoded.unwrap();
        assert_eq!(
            (got_header, got_kind, got.as_ref()),
            (header, kind, Ok(message)),
            "{name}"
        );
    }
}

#[test]
fn requests() {
    check(host_header(0x0102), &to_module(), TO_MODULE);
}

#[test]
fn answers() {
    check(module_header(0x0102), &from_module(), FROM_MODULE);
}

#[test]
fn refusals() {
    assert_eq!(rejects().len(), REJECTS.len());
    for (reason, (name, text)) in rejects().into_iter().zip(REJECTS) {
        assert_eq!(
            hex(&payload(&FromModule::Nack { request: 0, reason })),
            *text,
            "{name}"
        );
    }
}

#[test]
fn events() {
    assert_eq!(event_kinds().len(), EVENTS.len());
    for (kind, (name, text)) in event_kinds().into_iter().zip(EVENTS) {
        assert_eq!(
            hex(&payload(&FromModule::Event(Event {
                seq: 0,
                t_us: 0,
                kind
            }))),
            *text,
            "{name}"
        );
    }
}

#[test]
fn tag_and_digest() {
    assert_eq!(
        hex(&KEY.sign(&NONCE, 3, b"payload").0),
        "44057c1badd72dfee1351d47304fc63b"
    );
    assert_eq!(hex(&gait().digest().0), "4fc9e6e26150c519");
}
