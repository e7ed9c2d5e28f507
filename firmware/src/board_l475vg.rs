//! STM32L475VG: clocks, pins, peripherals. The pins are those of ST's B-L475E-IOT01A kit, so a bare kit is a module.
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | motor bus, RS485, 1 Mbaud | USART2 with hardware driver enable | TX PD5, RX PD6, DE PD4 |
//! | host link over the cable | USART1 | TX PB6, RX PB7 |
//! | host link over the Bluetooth module | UART4 | TX PA0, RX PA1 |
//! | STOP input, contact to ground, normally closed | GPIO with pull-up | PD14 |
//! | battery through a divider | ADC1 channel 14 | PC5 |

use control::motion::MotionParams;
use embassy_executor::Spawner;
use embassy_stm32::adc::{Adc, SampleTime};
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::interrupt::typelevel as irq;
use embassy_stm32::peripherals::{ADC1, IWDG, PC5, UART4, USART1, USART2};
use embassy_stm32::rcc::{
    MSIRange, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk, mux::Clk48sel,
};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config as UartConfig};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, Peripherals, bind_interrupts, pac, peripherals, uid};
use firmware::app::App;
use firmware::crash::BLOCK_BYTES;
use firmware::entropy::EntropyError;
use firmware::ports::{Board, LinkKind, LinkPort, ResetCause};
use firmware::tasks;
use static_cell::{ConstStaticCell, StaticCell};

use crate::board_clock::SysTickClock;
use crate::board_rng::BoardRng;
use crate::board_store::FlashStore;
use crate::board_uart::{ErrorHook, UartBus, UartLinkRx, UartLinkTx, Watch, Watched};
use crate::{board_clock, board_fault, board_log};

/// HSI16 x 10 / 2.
const CORE_HZ: u32 = 80_000_000;
/// Motor bus speed; every byte takes 10 us.
const BUS_BAUD: u32 = 1_000_000;
/// The bus driver is on this long before the start bit and after the stop bit, sixteenths of a bit: one bit, 1 us. The transceiver needs a time to switch
/// over, and a start bit that begins with the enable signal is short by it. embassy 0.6 writes the first of the two numbers into both fields.
const DRIVER_ENABLE: u8 = 16;
/// Host link speed on both ports.
const LINK_BAUD: u32 = 115_200;
/// Watchdog period: the bound of the `Board` trait.
const WATCHDOG_US: u32 = 200_000;

/// Rings of the bus: the longest exchange is 12 motors, about 600 bytes in and 200 out.
const BUS_TX_RING: usize = 512;
const BUS_RX_RING: usize = 1024;
/// Rings of a host link. Receive: 80 ms of line time at 115200 baud.
const LINK_TX_RING: usize = 512;
const LINK_RX_RING: usize = 1024;

/// Battery divider: 2 x 2 cells give at most 8.4 V per pack; 33 kOhm over 10 kOhm brings that under the 3.3 V reference.
const DIVIDER_NUMERATOR: u32 = 43;
const DIVIDER_DENOMINATOR: u32 = 10;
/// Analogue reference of the kit, mV.
const REFERENCE_MV: u32 = 3300;
/// Full scale of the 12-bit converter.
const ADC_FULL_SCALE: u32 = 4095;
/// Below it no battery is connected: a kit fed over USB.
const BATTERY_FITTED_MV: u16 = 1000;

bind_interrupts!(struct Interrupts {
    USART1 => ErrorHook<irq::USART1>, BufferedInterruptHandler<USART1>;
    USART2 => ErrorHook<irq::USART2>, BufferedInterruptHandler<USART2>;
    UART4 => ErrorHook<irq::UART4>, BufferedInterruptHandler<UART4>;
});

static WIRE_WATCH: Watch = Watch::new(pac::USART1, LINK_RX_RING);
static BUS_WATCH: Watch = Watch::new(pac::USART2, BUS_RX_RING);
static RADIO_WATCH: Watch = Watch::new(pac::UART4, LINK_RX_RING);

impl Watched for irq::USART1 {
    fn watch() -> &'static Watch {
        &WIRE_WATCH
    }
}

impl Watched for irq::USART2 {
    fn watch() -> &'static Watch {
        &BUS_WATCH
    }
}

impl Watched for irq::UART4 {
    fn watch() -> &'static Watch {
        &RADIO_WATCH
    }
}

/// The motor bus of this board.
pub(crate) type Bus = UartBus<BUS_TX_RING>;
/// A host link of this board.
pub(crate) type Link = LinkPort<UartLinkRx, UartLinkTx<LINK_TX_RING>>;

fn clocks() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hsi = true;
    config.rcc.pll = Some(Pll {
        source: PllSource::HSI,
        prediv: PllPreDiv::DIV1,
        mul: PllMul::MUL10,
        divp: None,
        divq: None,
        divr: Some(PllRDiv::DIV2),
    });
    config.rcc.sys = Sysclk::PLL1_R;
    // 48 MHz for the random number generator.
    config.rcc.msi = Some(MSIRange::RANGE48M);
    config.rcc.mux.clk48sel = Clk48sel::MSI;
    config
}

/// Value of the option bytes' field RDP without readout protection.
const RDP_OPEN: u8 = 0xAA;

fn reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // The pin flag accompanies every internal reset, so it is asked last (RM0351 section 6.1).
    if flags.iwdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.borrstf() {
        // A power-up raises it too; below it the chip cannot tell.
        ResetCause::PowerOn
    } else if flags.fwrstf() || flags.oblrstf() || flags.lpwrrstf() || flags.wwdgrstf() {
        ResetCause::Other
    } else if flags.pinrstf() {
        ResetCause::Pin
    } else {
        ResetCause::PowerOn
    }
}

/// The rest of the board.
pub(crate) struct L475 {
    adc: Adc<'static, ADC1>,
    battery: Peri<'static, PC5>,
    rng: BoardRng,
    watchdog: IndependentWatchdog<'static, IWDG>,
    stop: Input<'static>,
    cause: ResetCause,
    crash: &'static mut [u8; BLOCK_BYTES],
}

impl Board for L475 {
    fn battery_mv(&mut self) -> Option<u16> {
        // The divider is of high resistance: longest sampling time, 8 us.
        let sample = self
            .adc
            .blocking_read(&mut self.battery, SampleTime::CYCLES640_5);
        let pin_mv = u32::from(sample) * REFERENCE_MV / ADC_FULL_SCALE;
        let mv = u16::try_from(pin_mv * DIVIDER_NUMERATOR / DIVIDER_DENOMINATOR).ok()?;
        (mv >= BATTERY_FITTED_MV).then_some(mv)
    }

    fn reset_cause(&self) -> ResetCause {
        self.cause
    }

    fn name(&self) -> &'static str {
        "stm32l475vg"
    }

    fn unique_id(&self) -> [u8; 12] {
        uid::uid()
    }

    fn entropy(&mut self) -> Result<[u8; 16], EntropyError> {
        self.rng.seed()
    }

    fn flash_readable(&self) -> bool {
        // Level 0 of the readout protection (RM0351 section 3.7.8).
        pac::FLASH.optr().read().rdp() == RDP_OPEN
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

struct Fitted {
    bus: Bus,
    wire: Link,
    radio: Link,
    store: FlashStore,
    board: L475,
}

fn link_config() -> UartConfig {
    let mut config = UartConfig::default();
    config.baudrate = LINK_BAUD;
    config
}

fn motor_bus(
    usart: Peri<'static, USART2>,
    rx: Peri<'static, peripherals::PD6>,
    tx: Peri<'static, peripherals::PD5>,
    enable: Peri<'static, peripherals::PD4>,
) -> Bus {
    static TX: StaticCell<[u8; BUS_TX_RING]> = StaticCell::new();
    static RX: StaticCell<[u8; BUS_RX_RING]> = StaticCell::new();
    let mut config = UartConfig::default();
    config.baudrate = BUS_BAUD;
    (config.de_assertion_time, config.de_deassertion_time) = (DRIVER_ENABLE, DRIVER_ENABLE);
    let (tx_ring, rx_ring) = (TX.init([0; BUS_TX_RING]), RX.init([0; BUS_RX_RING]));
    let uart = defmt::unwrap!(
        BufferedUart::new_with_de(usart, rx, tx, enable, Interrupts, tx_ring, rx_ring, config).ok()
    );
    let (tx, rx) = uart.split();
    UartBus {
        tx,
        rx,
        watch: &BUS_WATCH,
    }
}

fn wire_link(
    usart: Peri<'static, USART1>,
    rx: Peri<'static, peripherals::PB7>,
    tx: Peri<'static, peripherals::PB6>,
) -> Link {
    static TX: StaticCell<[u8; LINK_TX_RING]> = StaticCell::new();
    static RX: StaticCell<[u8; LINK_RX_RING]> = StaticCell::new();
    let (tx_ring, rx_ring) = (TX.init([0; LINK_TX_RING]), RX.init([0; LINK_RX_RING]));
    let uart = defmt::unwrap!(
        BufferedUart::new(usart, rx, tx, tx_ring, rx_ring, Interrupts, link_config()).ok()
    );
    let (tx, rx) = uart.split();
    LinkPort {
        kind: LinkKind::Wire,
        rx: UartLinkRx(rx, &WIRE_WATCH),
        tx: UartLinkTx(tx),
    }
}

fn radio_link(
    uart: Peri<'static, UART4>,
    rx: Peri<'static, peripherals::PA1>,
    tx: Peri<'static, peripherals::PA0>,
) -> Link {
    static TX: StaticCell<[u8; LINK_TX_RING]> = StaticCell::new();
    static RX: StaticCell<[u8; LINK_RX_RING]> = StaticCell::new();
    let (tx_ring, rx_ring) = (TX.init([0; LINK_TX_RING]), RX.init([0; LINK_RX_RING]));
    let uart = defmt::unwrap!(
        BufferedUart::new(uart, rx, tx, tx_ring, rx_ring, Interrupts, link_config()).ok()
    );
    let (tx, rx) = uart.split();
    LinkPort {
        kind: LinkKind::Radio,
        rx: UartLinkRx(rx, &RADIO_WATCH),
        tx: UartLinkTx(tx),
    }
}

fn fit(p: Peripherals, cause: ResetCause) -> Fitted {
    let mut watchdog = IndependentWatchdog::new(p.IWDG, WATCHDOG_US);
    watchdog.unleash();
    let board = L475 {
        adc: Adc::new(p.ADC1),
        battery: p.PC5,
        rng: BoardRng::new(p.RNG),
        watchdog,
        stop: Input::new(p.PD14, Pull::Up),
        cause,
        crash: defmt::unwrap!(board_fault::take_block()),
    };
    Fitted {
        bus: motor_bus(p.USART2, p.PD6, p.PD5, p.PD4),
        wire: wire_link(p.USART1, p.PB7, p.PB6),
        radio: radio_link(p.UART4, p.PA1, p.PA0),
        store: FlashStore::new(p.FLASH),
        board,
    }
}

/// Brings the chip up and spawns the application.
pub(crate) fn start(spawner: Spawner) {
    let core = defmt::unwrap!(cortex_m::Peripherals::take());
    let peripherals = embassy_stm32::init(clocks());
    board_log::init();
    board_clock::init(core.SYST, CORE_HZ);
    let cause = reset_cause();
    defmt::info!("start, reset cause {}", cause as u8);
    let fitted = fit(peripherals, cause);
    spawner.spawn(defmt::unwrap!(application(fitted).ok()));
}

#[embassy_executor::task]
async fn application(fitted: Fitted) {
    // Built at compile time: 50 KiB would not fit on the stack.
    static APP: ConstStaticCell<App> = ConstStaticCell::new(App::blank());
    let app = APP.take();
    app.fit(MotionParams::default());
    let Fitted {
        mut bus,
        wire,
        radio,
        mut store,
        mut board,
    } = fitted;
    // Returns after the reset order only, and that has reset the chip.
    tasks::run(
        app,
        &SysTickClock,
        &mut bus,
        &mut store,
        &mut board,
        wire,
        radio,
    )
    .await;
}
