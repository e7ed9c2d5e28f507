//! Which ports this computer has, and which of them answer as a robot.

use std::path::PathBuf;
use std::time::Duration;

use protocol::link::Hello;
use serialport::{SerialPortInfo, SerialPortType};

use super::keys::KeyStore;
use super::{LinkError, PortUri, Robot, serial::SerialLink};

/// A probe waits this long for HELLO: five times the round trip over Bluetooth.
const PROBE: Duration = Duration::from_millis(500);

/// A serial port that may lead to a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Path.
    pub path: PathBuf,
    /// `usb`, `bluetooth`, `pci` or `unknown`.
    pub kind: &'static str,
    /// USB vendor and product id.
    pub usb_ids: Option<(u16, u16)>,
    /// USB serial number.
    pub serial: Option<String>,
    /// USB product name.
    pub product: Option<String>,
}

impl Candidate {
    /// Whether a robot can be behind it: USB and Bluetooth ports; built-in ones only when named.
    #[must_use]
    pub fn is_likely(&self) -> bool {
        matches!(self.kind, "usb" | "bluetooth")
    }

    /// The port URI.
    #[must_use]
    pub fn uri(&self) -> PortUri {
        PortUri::Serial(self.path.clone())
    }
}

/// All serial ports, in the order of their paths.
#[must_use]
pub fn candidates() -> Vec<Candidate> {
    let ports = serialport::available_ports().unwrap_or_default();
    let mut list: Vec<Candidate> = ports.into_iter().map(candidate).collect();
    list.sort_by(|a, b| a.path.cmp(&b.path));
    list
}

fn candidate(info: SerialPortInfo) -> Candidate {
    let path = PathBuf::from(&info.port_name);
    let plain = |kind| Candidate {
        path: path.clone(),
        kind,
        usb_ids: None,
        serial: None,
        product: None,
    };
    match info.port_type {
        SerialPortType::UsbPort(usb) => Candidate {
            usb_ids: Some((usb.vid, usb.pid)),
            serial: usb.serial_number,
            product: usb.product,
            ..plain("usb")
        },
        SerialPortType::BluetoothPort => plain("bluetooth"),
        SerialPortType::PciPort => plain("pci"),
        SerialPortType::Unknown if info.port_name.contains("rfcomm") => plain("bluetooth"),
        SerialPortType::Unknown => plain("unknown"),
    }
}

/// Asks one port for HELLO.
///
/// # Errors
/// [`LinkError`]
pub fn probe(candidate: &Candidate, baud: u32) -> Result<Hello, LinkError> {
    let link = SerialLink::open(&candidate.path, baud)?;
    let robot = Robot::connect(Box::new(link), PROBE, &KeyStore::new(None, None))?;
    Ok(robot.hello().clone())
}
