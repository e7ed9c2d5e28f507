//! What a board file gives, and the parts it builds that from.

use embassy_stm32::adc::{Adc, AdcChannel, AnyAdcChannel, SampleTime};
use embassy_stm32::gpio::Input;
use embassy_stm32::mode::Blocking;
use embassy_stm32::pac::usart::Usart;
use embassy_stm32::peripherals::ADC1;
use embassy_stm32::usart::{Config as UartConfig, ConfigError, Uart};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, Peripherals, peripherals};
use firmware::ports::{LinkKind, LinkPort, ResetCause};

use super::uart::{Port, UartBus, UartLinkRx, UartLinkTx};

/// Motor bus speed; every byte takes 10 us.
const BUS_BAUD: u32 = 1_000_000;
/// The bus driver is on this long before the start bit and after the stop bit, sixteenths of a bit: one bit, 1 us. The transceiver needs a time to switch
/// over, and a start bit that begins with the enable signal is short by it. embassy 0.6 writes the first of the two numbers into both fields.
const DRIVER_ENABLE: u8 = 16;
/// Host link speed on both ports.
const LINK_BAUD: u32 = 115_200;
/// Watchdog period: the bound of the `Board` trait.
const WATCHDOG_US: u32 = 200_000;

/// Send ring of the bus: the longest exchange is 12 motors, about 200 bytes out.
const BUS_TX_RING: usize = 512;
/// Receive ring of the bus: about 600 bytes come in.
const BUS_RX_RING: usize = 1024;
/// Send ring of a host link.
const LINK_TX_RING: usize = 512;
/// Receive ring of a host link: 80 ms of line time at 115200 baud.
const LINK_RX_RING: usize = 1024;

/// The motor bus.
pub(crate) type Bus = UartBus<BUS_TX_RING, BUS_RX_RING>;
/// A host link.
pub(crate) type Link =
    LinkPort<UartLinkRx<LINK_TX_RING, LINK_RX_RING>, UartLinkTx<LINK_TX_RING, LINK_RX_RING>>;
/// The UART of the motor bus with its rings.
pub(crate) type BusUart = Port<BUS_TX_RING, BUS_RX_RING>;
/// The UART of a host link with its rings.
pub(crate) type LinkUart = Port<LINK_TX_RING, LINK_RX_RING>;

/// Says which three UARTs a board has: their interrupts and their ports, called `BUS`, `WIRE` and `RADIO`. Once, in a board file.
macro_rules! uarts {
    (bus: $bus:ident, wire: $wire:ident, radio: $radio:ident) => {
        embassy_stm32::bind_interrupts!(struct Interrupts {
            $bus => $crate::stm32::uart::Service<embassy_stm32::interrupt::typelevel::$bus>;
            $wire => $crate::stm32::uart::Service<embassy_stm32::interrupt::typelevel::$wire>;
            $radio => $crate::stm32::uart::Service<embassy_stm32::interrupt::typelevel::$radio>;
        });
        $crate::stm32::parts::uarts!($bus, BUS: BusUart);
        $crate::stm32::parts::uarts!($wire, WIRE: LinkUart);
        $crate::stm32::parts::uarts!($radio, RADIO: LinkUart);
    };
    ($uart:ident, $port:ident: $kind:ident) => {
        static $port: $crate::stm32::parts::$kind =
            $crate::stm32::parts::$kind::new(embassy_stm32::pac::$uart);

        impl $crate::stm32::uart::Served for embassy_stm32::interrupt::typelevel::$uart {
            fn on_interrupt() {
                $port.on_interrupt();
            }
        }
    };
}
pub(crate) use uarts;

/// The battery's pin behind its divider, and the converter.
pub(crate) struct Battery {
    adc: Adc<'static, ADC1>,
    pin: AnyAdcChannel<'static, ADC1>,
}

impl Battery {
    pub(crate) fn new(adc: Adc<'static, ADC1>, pin: impl AdcChannel<ADC1> + 'static) -> Self {
        Self {
            adc,
            pin: pin.degrade_adc(),
        }
    }

    /// One conversion, 12 bits at a reference of 3.3 V. Bounded.
    pub(crate) fn sample(&mut self) -> u16 {
        // The divider is of high resistance: longest sampling time, 8 us at 80 MHz and 15 us at 42.5 MHz.
        self.adc
            .blocking_read(&mut self.pin, SampleTime::CYCLES640_5)
    }
}

/// What `fit` has made of the chip's peripherals.
pub(crate) struct Fitted {
    pub(crate) bus: Bus,
    pub(crate) wire: Link,
    pub(crate) radio: Link,
    /// From [`watchdog`]: it runs already.
    pub(crate) watchdog: IndependentWatchdog<'static, peripherals::IWDG>,
    /// With pull-up; a contact to ground, normally closed.
    pub(crate) stop: Input<'static>,
    pub(crate) battery: Battery,
    pub(crate) flash: Peri<'static, peripherals::FLASH>,
    pub(crate) rng: Peri<'static, peripherals::RNG>,
}

/// What a board file says of its board.
pub(crate) trait BoardFile {
    /// As told in HELLO: at most 16 characters.
    const NAME: &'static str;
    /// The core's clock that [`BoardFile::clocks`] sets: a multiple of 1 MHz.
    const CORE_HZ: u32;
    /// Size of the flash. The slot store is its end, in pages of 2 KiB, and the memory map leaves that out.
    const FLASH_BYTES: usize;
    /// The UART of the motor bus, which a fault silences.
    const BUS: Usart;

    /// Clock tree. The random number generator needs its 48 MHz.
    fn clocks() -> embassy_stm32::Config;

    /// Why the chip started; clears the flags. Called once.
    fn reset_cause() -> ResetCause;

    /// Brings up the peripherals, the watchdog first. Called once.
    fn fit(peripherals: Peripherals) -> Fitted;
}

/// The watchdog, running.
pub(crate) fn watchdog(
    peripheral: Peri<'static, peripherals::IWDG>,
) -> IndependentWatchdog<'static, peripherals::IWDG> {
    let mut watchdog = IndependentWatchdog::new(peripheral, WATCHDOG_US);
    watchdog.unleash();
    watchdog
}

/// Settings of the UART of the motor bus.
pub(crate) fn bus_config() -> UartConfig {
    let mut config = UartConfig::default();
    config.baudrate = BUS_BAUD;
    (config.de_assertion_time, config.de_deassertion_time) = (DRIVER_ENABLE, DRIVER_ENABLE);
    config
}

/// Settings of the UART of a host link.
pub(crate) fn link_config() -> UartConfig {
    let mut config = UartConfig::default();
    config.baudrate = LINK_BAUD;
    config
}

/// The motor bus over a UART.
pub(crate) fn bus(
    uart: Result<Uart<'static, Blocking>, ConfigError>,
    port: &'static BusUart,
) -> Bus {
    port.open(defmt::unwrap!(uart.ok()));
    UartBus(port)
}

/// A host link over a UART.
pub(crate) fn link(
    kind: LinkKind,
    uart: Result<Uart<'static, Blocking>, ConfigError>,
    port: &'static LinkUart,
) -> Link {
    port.open(defmt::unwrap!(uart.ok()));
    LinkPort {
        kind,
        rx: UartLinkRx(port),
        tx: UartLinkTx(port),
    }
}
