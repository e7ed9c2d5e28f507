//! STM32G474RE: clocks, pins, peripherals. The pins fit ST's NUCLEO-G474RE kit, whose ST-LINK has its serial port at PA2 and PA3. Never run.
//!
//! The flash must be in its two-bank mode (option DBANK, as delivered): else its pages have 4 KiB, and the start ends in a reset, again and again.
//!
//! | function | peripheral | pins |
//! |---|---|---|
//! | motor bus, RS485, 1 Mbaud | USART1 with hardware driver enable | TX PA9, RX PA10, DE PA12 |
//! | host link over the cable | USART2 | TX PA2, RX PA3 |
//! | host link over the Bluetooth module | USART3 | TX PC10, RX PC11 |
//! | STOP input, contact to ground, normally closed | GPIO with pull-up | PA8 |
//! | battery through a divider | ADC1 channel 1 | PA0 |

use embassy_stm32::adc::{Adc, AdcConfig};
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::pac::usart::Usart;
use embassy_stm32::rcc::mux::{Adcsel, Clk48sel};
use embassy_stm32::rcc::{Hsi48Config, Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk};
use embassy_stm32::usart::Uart;
use embassy_stm32::{Peripherals, pac};
use firmware::ports::{LinkKind, ResetCause};

use crate::stm32::parts::{
    Battery, BoardFile, Fitted, bus, bus_config, link, link_config, uarts, watchdog,
};

uarts!(bus: USART1, wire: USART2, radio: USART3);

/// The board.
pub(crate) struct G474;

impl BoardFile for G474 {
    const NAME: &'static str = "stm32g474re";
    /// HSI16 / 4 x 85 / 2.
    const CORE_HZ: u32 = 170_000_000;
    const FLASH_BYTES: usize = 512 * 1024;
    const BUS: Usart = pac::USART1;

    fn clocks() -> embassy_stm32::Config {
        let mut config = embassy_stm32::Config::default();
        config.rcc.hsi = true;
        config.rcc.pll = Some(Pll {
            source: PllSource::HSI,
            prediv: PllPreDiv::DIV4,
            mul: PllMul::MUL85,
            divp: None,
            divq: None,
            divr: Some(PllRDiv::DIV2),
        });
        config.rcc.sys = Sysclk::PLL1_R;
        // The core's supply for more than 150 MHz.
        config.rcc.boost = true;
        // 48 MHz for the random number generator.
        config.rcc.hsi48 = Some(Hsi48Config::new());
        config.rcc.mux.clk48sel = Clk48sel::HSI48;
        // Without it the converter has no clock. 170 MHz / 4.
        config.rcc.mux.adc12sel = Adcsel::SYS;
        config
    }

    fn reset_cause() -> ResetCause {
        let flags = pac::RCC.csr().read();
        pac::RCC.csr().modify(|w| w.set_rmvf(true));
        // The pin flag accompanies every internal reset, so it is asked last (RM0440, RCC_CSR).
        if flags.iwdgrstf() {
            ResetCause::Watchdog
        } else if flags.sftrstf() {
            ResetCause::Software
        } else if flags.borrstf() {
            // A power-up raises it too; below it the chip cannot tell.
            ResetCause::PowerOn
        } else if flags.oblrstf() || flags.lpwrrstf() || flags.wwdgrstf() {
            ResetCause::Other
        } else if flags.pinrstf() {
            ResetCause::Pin
        } else {
            ResetCause::PowerOn
        }
    }

    fn fit(p: Peripherals) -> Fitted {
        let watchdog = watchdog(p.IWDG);
        let motors = Uart::new_blocking_with_de(p.USART1, p.PA10, p.PA9, p.PA12, bus_config());
        let wire = Uart::new_blocking(p.USART2, p.PA3, p.PA2, link_config());
        let radio = Uart::new_blocking(p.USART3, p.PC11, p.PC10, link_config());
        Fitted {
            bus: bus(motors, &BUS),
            wire: link(LinkKind::Wire, wire, &WIRE),
            radio: link(LinkKind::Radio, radio, &RADIO),
            watchdog,
            stop: Input::new(p.PA8, Pull::Up),
            battery: Battery::new(Adc::new(p.ADC1, AdcConfig::default()), p.PA0),
            flash: p.FLASH,
            rng: p.RNG,
        }
    }
}
