//! STM32L475VG: clocks, pins, peripherals. The pins are those of ST's B-L475E-IOT01A kit, so a bare kit is a module.
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | motor bus, RS485, 1 Mbaud | USART2 with hardware driver enable | TX PD5, RX PD6, DE PD4 |
//! | host link over the cable | USART1 | TX PB6, RX PB7 |
//! | host link over the Bluetooth module | UART4 | TX PA0, RX PA1 |
//! | STOP input, contact to ground, normally closed | GPIO with pull-up | PD14 |
//! | battery through a divider | ADC1 channel 14 | PC5 |

use embassy_stm32::adc::Adc;
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::pac::usart::Usart;
use embassy_stm32::rcc::{
    MSIRange, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk, mux::Clk48sel,
};
use embassy_stm32::usart::Uart;
use embassy_stm32::{Peripherals, pac};
use firmware::ports::{LinkKind, ResetCause};

use crate::stm32::parts::{
    Battery, BoardFile, Fitted, bus, bus_config, link, link_config, uarts, watchdog,
};

uarts!(bus: USART2, wire: USART1, radio: UART4);

/// The board.
pub(crate) struct L475;

impl BoardFile for L475 {
    const NAME: &'static str = "stm32l475vg";
    /// HSI16 x 10 / 2.
    const CORE_HZ: u32 = 80_000_000;
    const FLASH_BYTES: usize = 1024 * 1024;
    const BUS: Usart = pac::USART2;

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

    fn fit(p: Peripherals) -> Fitted {
        let watchdog = watchdog(p.IWDG);
        let motors = Uart::new_blocking_with_de(p.USART2, p.PD6, p.PD5, p.PD4, bus_config());
        let wire = Uart::new_blocking(p.USART1, p.PB7, p.PB6, link_config());
        let radio = Uart::new_blocking(p.UART4, p.PA1, p.PA0, link_config());
        Fitted {
            bus: bus(motors, &BUS),
            wire: link(LinkKind::Wire, wire, &WIRE),
            radio: link(LinkKind::Radio, radio, &RADIO),
            watchdog,
            stop: Input::new(p.PD14, Pull::Up),
            battery: Battery::new(Adc::new(p.ADC1), p.PC5),
            flash: p.FLASH,
            rng: p.RNG,
        }
    }
}
