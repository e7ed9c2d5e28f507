//! The control table: addresses of the X series (Robotis e-manual, XM430-W350) where foreign clients expect them, our own block from 1024 on.

/// Our model number, "RB" as bytes. No Robotis device has it.
pub const MODEL_NUMBER: i32 = 0x4252;
/// Version of this control table, register 6.
pub const TABLE_VERSION: i32 = 1;
/// First address behind the X-series part.
pub const X_END: u16 = 148;
/// First address of our own block.
pub const OWN_START: u16 = 1024;
/// First address behind our own block.
pub const OWN_END: u16 = 1024 + 64;
/// The packed feedback block, [`super::PackedFeedback`], 19 bytes, read only.
pub const PACKED_FEEDBACK: u16 = 1064;
/// What [`Register::ZeroHere`] wants to be written: chosen so that no stray 0 or 1 revokes a zero.
pub const ZERO_HERE_MAGIC: i32 = 0x5A;
/// Value of [`Register::BaudRate`] for 1 Mbaud, as in the X series.
pub const BAUD_1M: i32 = 3;
/// Value of [`Register::BusWatchdog`] after it has tripped; writing 0 clears it.
pub const WATCHDOG_TRIPPED: i32 = -1;
/// Nanoseconds per count of [`Register::ReturnDelay`].
pub const RETURN_DELAY_NS: u64 = 2000;
/// Milliseconds per count of [`Register::BusWatchdog`].
pub const WATCHDOG_MS: u32 = 20;

use crate::units::MAX_ANGLE_URAD;

/// Who may do what with a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Access {
    /// Read only.
    Read,
    /// Kept over a restart; written only while torque is off.
    Eeprom,
    /// Back to its default at a restart.
    Ram,
}

/// What the table says about one register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegisterInfo {
    /// Register.
    pub register: Register,
    /// Name, as in the e-manual for X-series registers.
    pub name: &'static str,
    /// First address.
    pub address: u16,
    /// Bytes: 1, 2 or 4.
    pub len: u8,
    /// Access.
    pub access: Access,
    /// Whether the value is two's complement.
    pub signed: bool,
    /// Smallest value that may be written.
    pub min: i32,
    /// Largest value that may be written.
    pub max: i32,
    /// Value after the first start (EEPROM) or every restart (RAM).
    pub default: i32,
}

macro_rules! table {
    ($( $(#[$doc:meta])* $register:ident $name:literal $address:literal $len:literal $access:ident $sign:ident
        [$min:expr, $max:expr] = $default:expr; )*) => {
        /// A register of the control table.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub enum Register { $( $(#[$doc])* $register, )* }

        /// Every register, in the order of addresses.
        pub const TABLE: &[RegisterInfo] = &[ $( table!(@info $register $name $address $len $access $sign $min, $max, $default), )* ];

        impl Register {
            /// Number of registers.
            pub const COUNT: usize = TABLE.len();

            /// What the table says about it.
            #[must_use]
            pub const fn info(self) -> &'static RegisterInfo {
                match self {
                    $( Self::$register => const {
                        &table!(@info $register $name $address $len $access $sign $min, $max, $default)
                    }, )*
                }
            }
        }
    };
    (@info $register:ident $name:literal $address:literal $len:literal $access:ident $sign:ident $min:expr, $max:expr, $default:expr) => {
        RegisterInfo {
            register: Register::$register, name: $name, address: $address, len: $len, access: Access::$access,
            signed: table!(@$sign), min: $min, max: $max, default: $default,
        }
    };
    (@unsigned) => { false };
    (@signed) => { true };
}

table! {
    /// Our model number.
    ModelNumber "Model Number" 0 2 Read unsigned [0, 0xFFFF] = MODEL_NUMBER;
    /// Free.
    ModelInformation "Model Information" 2 4 Read unsigned [0, 0] = 0;
    /// Version of the control table.
    FirmwareVersion "Firmware Version" 6 1 Read unsigned [0, 255] = TABLE_VERSION;
    /// Address on the bus.
    Id "ID" 7 1 Eeprom unsigned [0, 252] = 1;
    /// 3 = 1 Mbaud.
    BaudRate "Baud Rate" 8 1 Eeprom unsigned [0, 7] = BAUD_1M;
    /// Wait before an answer, 2 us per count. 0 here; 250 at Robotis.
    ReturnDelay "Return Delay Time" 9 1 Eeprom unsigned [0, 254] = 0;
    /// Bit 0: reverse direction.
    DriveMode "Drive Mode" 10 1 Eeprom unsigned [0, 13] = 0;
    /// 0 current, 1 velocity, 3 position, 4 extended position, 5 current-based position, 16 PWM.
    OperatingMode "Operating Mode" 11 1 Eeprom unsigned [0, 16] = 4;
    /// 255 = none.
    SecondaryId "Secondary ID" 12 1 Eeprom unsigned [0, 255] = 255;
    /// 2.
    ProtocolType "Protocol Type" 13 1 Eeprom unsigned [2, 2] = 2;
    /// Added to the position, 0.088 deg per count.
    HomingOffset "Homing Offset" 20 4 Eeprom signed [-1_044_479, 1_044_479] = 0;
    /// 0.229 rpm per count.
    MovingThreshold "Moving Threshold" 24 4 Eeprom unsigned [0, 1023] = 3;
    /// deg C.
    TemperatureLimit "Temperature Limit" 31 1 Eeprom unsigned [0, 100] = 80;
    /// 0.1 V.
    MaxVoltageLimit "Max Voltage Limit" 32 2 Eeprom unsigned [31, 160] = 160;
    /// 0.1 V. Two LiPo cells must not fall below 6 V.
    MinVoltageLimit "Min Voltage Limit" 34 2 Eeprom unsigned [31, 160] = 60;
    /// 0.113 % per count.
    PwmLimit "PWM Limit" 36 2 Eeprom unsigned [0, 885] = 885;
    /// 2.69 mA per count.
    CurrentLimit "Current Limit" 38 2 Eeprom unsigned [0, 2047] = 1193;
    /// 0.229 rpm per count.
    VelocityLimit "Velocity Limit" 44 4 Eeprom unsigned [0, 2047] = 200;
    /// 0.088 deg per count; not used in extended position mode.
    MaxPositionLimit "Max Position Limit" 48 4 Eeprom unsigned [0, 4095] = 4095;
    /// 0.088 deg per count; not used in extended position mode.
    MinPositionLimit "Min Position Limit" 52 4 Eeprom unsigned [0, 4095] = 0;
    /// Hardware errors that switch torque off: bit 0 voltage, 2 overheat, 3 encoder, 4 shock, 5 overload.
    Shutdown "Shutdown" 63 1 Eeprom unsigned [0, 63] = 52;
    /// 1 = torque on.
    TorqueEnable "Torque Enable" 64 1 Ram unsigned [0, 1] = 0;
    /// 1 = on.
    Led "LED" 65 1 Ram unsigned [0, 1] = 0;
    /// 0 ping only, 1 ping and read, 2 every instruction.
    StatusReturnLevel "Status Return Level" 68 1 Ram unsigned [0, 2] = 2;
    /// 1 = a Reg Write waits for its Action.
    RegisteredInstruction "Registered Instruction" 69 1 Read unsigned [0, 1] = 0;
    /// Bits as in [`Register::Shutdown`]; latched until a reboot.
    HardwareError "Hardware Error Status" 70 1 Read unsigned [0, 255] = 0;
    /// Gain / 65536.
    VelocityIGain "Velocity I Gain" 76 2 Ram unsigned [0, 16383] = 1920;
    /// Gain / 128.
    VelocityPGain "Velocity P Gain" 78 2 Ram unsigned [0, 16383] = 100;
    /// Gain / 16.
    PositionDGain "Position D Gain" 80 2 Ram unsigned [0, 16383] = 0;
    /// Gain / 65536.
    PositionIGain "Position I Gain" 82 2 Ram unsigned [0, 16383] = 0;
    /// Gain / 128.
    PositionPGain "Position P Gain" 84 2 Ram unsigned [0, 16383] = 800;
    /// Gain / 4.
    FeedforwardSecondGain "Feedforward 2nd Gain" 88 2 Ram unsigned [0, 16383] = 0;
    /// Gain / 4.
    FeedforwardFirstGain "Feedforward 1st Gain" 90 2 Ram unsigned [0, 16383] = 0;
    /// 20 ms per count, 0 = off, -1 = tripped: goals refused until 0 is written.
    BusWatchdog "Bus Watchdog" 98 1 Ram signed [0, 127] = 0;
    /// 0.113 % per count.
    GoalPwm "Goal PWM" 100 2 Ram signed [-885, 885] = 885;
    /// 2.69 mA per count.
    GoalCurrent "Goal Current" 102 2 Ram signed [-2047, 2047] = 1193;
    /// 0.229 rpm per count.
    GoalVelocity "Goal Velocity" 104 4 Ram signed [-2047, 2047] = 0;
    /// 214.577 rev/min^2 per count, 0 = no limit.
    ProfileAcceleration "Profile Acceleration" 108 4 Ram unsigned [0, 32767] = 0;
    /// 0.229 rpm per count, 0 = no limit.
    ProfileVelocity "Profile Velocity" 112 4 Ram unsigned [0, 32767] = 0;
    /// 0.088 deg per count.
    GoalPosition "Goal Position" 116 4 Ram signed [-1_048_575, 1_048_575] = 0;
    /// ms, 0..=32767, wraps.
    RealtimeTick "Realtime Tick" 120 2 Read unsigned [0, 32767] = 0;
    /// 1 = above the moving threshold.
    Moving "Moving" 122 1 Read unsigned [0, 1] = 0;
    /// Bit 0: in position.
    MovingStatus "Moving Status" 123 1 Read unsigned [0, 255] = 0;
    /// 0.113 % per count.
    PresentPwm "Present PWM" 124 2 Read signed [-885, 885] = 0;
    /// 2.69 mA per count.
    PresentCurrent "Present Current" 126 2 Read signed [-32768, 32767] = 0;
    /// 0.229 rpm per count.
    PresentVelocity "Present Velocity" 128 4 Read signed [i32::MIN, i32::MAX] = 0;
    /// 0.088 deg per count.
    PresentPosition "Present Position" 132 4 Read signed [i32::MIN, i32::MAX] = 0;
    /// 0.229 rpm per count.
    VelocityTrajectory "Velocity Trajectory" 136 4 Read signed [i32::MIN, i32::MAX] = 0;
    /// 0.088 deg per count.
    PositionTrajectory "Position Trajectory" 140 4 Read signed [i32::MIN, i32::MAX] = 0;
    /// 0.1 V per count.
    PresentInputVoltage "Present Input Voltage" 144 2 Read unsigned [0, 65535] = 0;
    /// deg C.
    PresentTemperature "Present Temperature" 146 1 Read unsigned [0, 255] = 0;
    /// Always 0: no backup.
    BackupReady "Backup Ready" 147 1 Read unsigned [0, 1] = 0;
    /// Set-point, urad. The newer of this and Goal Position counts.
    GoalAngle "Goal Angle" 1024 4 Ram signed [-MAX_ANGLE_URAD, MAX_ANGLE_URAD] = 0;
    /// Angle, urad.
    PresentAngle "Present Angle" 1028 4 Read signed [i32::MIN, i32::MAX] = 0;
    /// Set-point that the loop follows now, urad.
    AppliedAngle "Applied Angle" 1032 4 Read signed [i32::MIN, i32::MAX] = 0;
    /// us since the start of the driver, wraps.
    TickUs "Tick" 1036 4 Read unsigned [i32::MIN, i32::MAX] = 0;
    /// 0.5 mrad/s per count.
    FineVelocity "Fine Velocity" 1040 2 Read signed [-32768, 32767] = 0;
    /// mA.
    FineCurrent "Fine Current" 1042 2 Read signed [-32768, 32767] = 0;
    /// 1/2000 per count.
    FineDuty "Fine Duty" 1044 2 Read signed [-32768, 32767] = 0;
    /// 5 mV per count.
    FineVoltage "Fine Voltage" 1046 2 Read unsigned [0, 65535] = 0;
    /// Starts of the driver, modulo 256.
    BootCount "Boot Count" 1048 1 Read unsigned [0, 255] = 0;
    /// Bits of [`super::feedback::status`].
    StatusBits "Status Bits" 1049 1 Read unsigned [0, 255] = 0;
    /// Write 0x5A: here is zero. Reads 1 when a zero was set since the start.
    ZeroHere "Zero Here" 1050 1 Ram unsigned [ZERO_HERE_MAGIC, ZERO_HERE_MAGIC] = 0;
    /// A Goal Angle further than this from the applied set-point (or, after torque on, from the present angle) is refused, urad. Default 2.5 times what the faster motor turns in 50 ms.
    GoalStepLimit "Goal Step Limit" 1052 4 Ram unsigned [0, MAX_ANGLE_URAD] = 350_000;
}

impl Register {
    /// The register that begins at this address.
    #[must_use]
    pub fn at(address: u16) -> Option<Self> {
        TABLE
            .iter()
            .find(|info| info.address == address)
            .map(|info| info.register)
    }

    /// First address.
    #[must_use]
    pub const fn address(self) -> u16 {
        self.info().address
    }

    /// Bytes.
    #[must_use]
    pub const fn size(self) -> u16 {
        self.info().len as u16
    }

    /// The value of its first `len` bytes, sign-extended where the register is signed. Missing bytes count as 0.
    #[must_use]
    pub fn value_of(self, bytes: &[u8]) -> i32 {
        let mut word = [0; 4];
        for (to, from) in word
            .iter_mut()
            .zip(bytes.iter().take(usize::from(self.size())))
        {
            *to = *from;
        }
        let unused = 32_u32.saturating_sub(u32::from(self.size()) * 8) & 31;
        let raw = i32::from_le_bytes(word);
        if self.info().signed {
            (raw << unused) >> unused
        } else {
            raw
        }
    }
}

/// A plain store for every register, for drivers to build on: defaults, ranges already checked by the server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RegisterFile {
    values: [i32; Register::COUNT],
}

impl Default for RegisterFile {
    fn default() -> Self {
        Self::new()
    }
}

impl RegisterFile {
    /// All defaults.
    #[must_use]
    pub fn new() -> Self {
        let mut values = [0; Register::COUNT];
        for (value, info) in values.iter_mut().zip(TABLE) {
            *value = info.default;
        }
        Self { values }
    }

    /// Value of a register.
    #[must_use]
    pub fn get(&self, register: Register) -> i32 {
        self.values.get(register as usize).copied().unwrap_or(0)
    }

    /// Sets a register, read-only ones too: this is the driver's own side.
    pub fn set(&mut self, register: Register, value: i32) {
        if let Some(place) = self.values.get_mut(register as usize) {
            *place = value;
        }
    }

    /// A restart: everything but the EEPROM area returns to its default.
    pub fn restart(&mut self) {
        for (value, info) in self.values.iter_mut().zip(TABLE) {
            if info.access != Access::Eeprom {
                *value = info.default;
            }
        }
    }
}
