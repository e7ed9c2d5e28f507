//! STM32L475VG: clocks, pins, peripherals. The pins are those of ST's B-L475E-IOT01A kit, so a bare kit is a module.
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | motor bus, RS485, 1 Mbaud | USART2 with hardware driver enable | TX PD5, RX PD6, DE PD4 |
//! | host link over the cable | USART1 | TX PB6, RX PB7 |
//! | host link over the Bluetooth module | UART4 | TX PA0, RX PA1 |
//! | STOP input, contact to ground, normally closed | GPIO with pull-up | PD14 |
//! | battery through a divider | ADC1 channel 14 | PC5 |

use embassy_stm32::adc::{Adc, SampleTime};
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::interrupt::typelevel as irq;
use embassy_stm32::pac::usart::Usart;
use embassy_stm32::peripherals::{ADC1, PC5, UART4, USART1, USART2};
use embassy_stm32::rcc::{
    MSIRange, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk, mux::Clk48sel,
};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart};
use embassy_stm32::{Peri, Peripherals, bind_interrupts, pac};
use firmware::ports::{LinkKind, ResetCause};

use crate::stm32::parts::{
    BUS_RX_RING, Battery, BoardFile, BusRings, Fitted, LINK_RX_RING, LinkRings, bus, bus_config,
    link, link_config, watchdog,
};
use crate::stm32::uart::{ErrorHook, Watch, Watched};

bind_interrupts!(struct Interrupts {
    USART1 => ErrorHook<irq::USART1>, BufferedInterruptHandler<USART1>;
    USART2 => ErrorHook<irq::USART2>, BufferedInterruptHandler<USART2>;
    UART4 => ErrorHook<irq::UART4>, BufferedInterruptHandler<UART4>;
});

static WIRE_WATCH: Watch = Watch::new(pac::USART1, LINK_RX_RING);
static BUS_WATCH: Watch = Watch::new(pac::USART2, BUS_RX_RING);
static RADIO_WATCH: Watch = Watch::new(pac::UART4, LINK_RX_RING);

static WIRE_RINGS: LinkRings = LinkRings::new();
static BUS_RINGS: BusRings = BusRings::new();
static RADIO_RINGS: LinkRings = LinkRings::new();

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

/// The battery's pin and its converter.
pub(crate) struct Divider {
    adc: Adc<'static, ADC1>,
    pin: Peri<'static, PC5>,
}

impl Battery for Divider {
    fn sample(&mut self) -> u16 {
        // The divider is of high resistance: longest sampling time, 8 us.
        self.adc
            .blocking_read(&mut self.pin, SampleTime::CYCLES640_5)
    }
}

/// The board.
pub(crate) struct L475;

impl BoardFile for L475 {
    const NAME: &'static str = "stm32l475vg";
    /// HSI16 x 10 / 2.
    const CORE_HZ: u32 = 80_000_000;
    const FLASH_BYTES: usize = 1024 * 1024;
    const BUS: Usart = pac::USART2;
    type Battery = Divider;

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

    fn fit(p: Peripherals) -> Fitted<Divider> {
        let watchdog = watchdog(p.IWDG);
        let (tx, rx) = BUS_RINGS.take();
        let motors = BufferedUart::new_with_de(
            p.USART2,
            p.PD6,
            p.PD5,
            p.PD4,
            Interrupts,
            tx,
            rx,
            bus_config(),
        );
        let (tx, rx) = WIRE_RINGS.take();
        let wire = BufferedUart::new(p.USART1, p.PB7, p.PB6, tx, rx, Interrupts, link_config());
        let (tx, rx) = RADIO_RINGS.take();
        let radio = BufferedUart::new(p.UART4, p.PA1, p.PA0, tx, rx, Interrupts, link_config());
        Fitted {
            bus: bus(motors, &BUS_WATCH),
            wire: link(LinkKind::Wire, wire, &WIRE_WATCH),
            radio: link(LinkKind::Radio, radio, &RADIO_WATCH),
            watchdog,
            stop: Input::new(p.PD14, Pull::Up),
            battery: Divider {
                adc: Adc::new(p.ADC1),
                pin: p.PC5,
            },
            flash: p.FLASH,
            rng: p.RNG,
        }
    }
}
