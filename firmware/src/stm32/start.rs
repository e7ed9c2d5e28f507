//! From reset to the running application, the same on every board.

use control::motion::MotionParams;
use embassy_executor::Spawner;
use embassy_stm32::gpio::Input;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{pac, peripherals, uid};
use firmware::app::App;
use firmware::crash::BLOCK_BYTES;
use firmware::entropy::EntropyError;
use firmware::ports::{Board, ResetCause};
use firmware::tasks;
use static_cell::ConstStaticCell;

use super::clock::SysTickClock;
use super::parts::{Battery, BoardFile, Bus, Fitted, Link};
use super::rng::BoardRng;
use super::store::FlashStore;
use super::{clock, fault, log};
use crate::board::Chosen;

/// Battery divider: 2 x 2 cells give at most 8.4 V per pack; 33 kOhm over 10 kOhm brings that under the 3.3 V reference.
const DIVIDER_NUMERATOR: u32 = 43;
const DIVIDER_DENOMINATOR: u32 = 10;
/// Analogue reference, mV.
const REFERENCE_MV: u32 = 3300;
/// Full scale of the 12-bit converter.
const ADC_FULL_SCALE: u32 = 4095;
/// Below it no battery is connected: a kit fed over USB.
const BATTERY_FITTED_MV: u16 = 1000;
/// Value of the option bytes' lowest field, RDP, without readout protection.
const RDP_OPEN: u8 = 0xAA;

/// The rest of the board.
struct Rest {
    battery: Battery,
    rng: BoardRng,
    watchdog: IndependentWatchdog<'static, peripherals::IWDG>,
    stop: Input<'static>,
    cause: ResetCause,
    crash: &'static mut [u8; BLOCK_BYTES],
}

impl Board for Rest {
    fn battery_mv(&mut self) -> Option<u16> {
        let pin_mv = u32::from(self.battery.sample()) * REFERENCE_MV / ADC_FULL_SCALE;
        let mv = u16::try_from(pin_mv * DIVIDER_NUMERATOR / DIVIDER_DENOMINATOR).ok()?;
        (mv >= BATTERY_FITTED_MV).then_some(mv)
    }

    fn reset_cause(&self) -> ResetCause {
        self.cause
    }

    fn name(&self) -> &'static str {
        Chosen::NAME
    }

    fn unique_id(&self) -> [u8; 12] {
        uid::uid()
    }

    fn entropy(&mut self) -> Result<[u8; 16], EntropyError> {
        self.rng.seed()
    }

    fn flash_readable(&self) -> bool {
        // Level 0 of the readout protection (RM0351 section 3.7.8). The cast keeps the field.
        pac::FLASH.optr().read().0 as u8 == RDP_OPEN
    }

    fn pet_watchdog(&mut self) {
        self.watchdog.pet();
    }

    fn stop_input(&mut self) -> bool {
        // Pressed, cut and unplugged look the same: the contact is open and the pull-up wins.
        self.stop.is_high()
    }

    fn crash_block(&mut self) -> &mut [u8; BLOCK_BYTES] {
        self.crash
    }

    fn reboot(&mut self) {
        cortex_m::peripheral::SCB::sys_reset()
    }
}

/// What the application runs over.
struct Ports {
    bus: Bus,
    wire: Link,
    radio: Link,
    store: FlashStore,
    rest: Rest,
}

/// Brings the chip up and spawns the application.
pub(crate) fn start(spawner: Spawner) {
    let core = defmt::unwrap!(cortex_m::Peripherals::take());
    let peripherals = embassy_stm32::init(Chosen::clocks());
    log::init();
    clock::init(core.SYST, Chosen::CORE_HZ);
    let cause = Chosen::reset_cause();
    defmt::info!("start, reset cause {}", cause as u8);
    let ports = ports(Chosen::fit(peripherals), cause);
    spawner.spawn(defmt::unwrap!(application(ports).ok()));
}

fn ports(fitted: Fitted, cause: ResetCause) -> Ports {
    Ports {
        bus: fitted.bus,
        wire: fitted.wire,
        radio: fitted.radio,
        store: FlashStore::new(fitted.flash),
        rest: Rest {
            battery: fitted.battery,
            rng: BoardRng::new(fitted.rng),
            watchdog: fitted.watchdog,
            stop: fitted.stop,
            cause,
            crash: defmt::unwrap!(fault::take_block()),
        },
    }
}

#[embassy_executor::task]
async fn application(ports: Ports) {
    // Built at compile time: 50 KiB would not fit on the stack.
    static APP: ConstStaticCell<App> = ConstStaticCell::new(App::blank());
    let app = APP.take();
    app.fit(MotionParams::default());
    let Ports {
        mut bus,
        wire,
        radio,
        mut store,
        mut rest,
    } = ports;
    // Returns after the reset order only, and that has reset the chip.
    tasks::run(
        app,
        &SysTickClock,
        &mut bus,
        &mut store,
        &mut rest,
        wire,
        radio,
    )
    .await;
}
