//! What every command gets: settings, output, and the way to a robot.

use std::io::IsTerminal;
use std::time::Duration;

use control::robot::RobotModel;
use protocol::link::{ModuleState, Tag, ToModule};

use crate::cli::{Global, parse_duration};
use crate::failure::{Exit, Failure, Outcome};
use crate::interrupt;
use crate::link::find::{self, Candidate};
use crate::link::keys::KeyStore;
use crate::link::{self, Link, LinkError, PortUri, Robot};
use crate::output::{Level, Output};
use crate::settings::{self, Key, Settings};

/// The emulated drivers have all been read once this long after power-up.
const EMULATED_START: Duration = Duration::from_millis(300);

/// What every command gets.
#[derive(Debug)]
pub struct Context {
    /// Where and how to print.
    pub out: Output,
    /// Settings with their origins.
    pub settings: Settings,
    /// Answer yes to questions.
    pub yes: bool,
}

impl Context {
    /// Gathers settings and starts to catch Ctrl-C.
    ///
    /// # Errors
    /// A bad configuration file or environment variable.
    pub fn new(global: &Global, out: Output) -> Outcome<Self> {
        interrupt::install(out.level == Level::Quiet);
        let settings = Settings::gather(global)?;
        Ok(Self {
            out,
            settings,
            yes: global.yes,
        })
    }

    /// The robot model that host checks use: the same defaults as the firmware.
    #[must_use]
    pub fn robot_model(&self) -> RobotModel {
        RobotModel::default()
    }

    /// Baud rate.
    #[must_use]
    pub fn baud(&self) -> u32 {
        self.settings
            .get(Key::Baud)
            .value
            .parse()
            .unwrap_or(115_200)
    }

    /// Longest wait for an answer.
    #[must_use]
    pub fn timeout(&self) -> Duration {
        parse_duration(&self.settings.get(Key::Timeout).value).unwrap_or(Duration::from_secs(2))
    }

    /// Where keys are kept.
    #[must_use]
    pub fn keys(&self) -> KeyStore {
        let file = self.settings.get(Key::KeyFile).value;
        let file = (!file.is_empty()).then(|| file.into());
        KeyStore::new(
            settings::user_folder().map(|folder| folder.join("keys")),
            file,
        )
    }

    /// The port: as set, else the only device that answers, else the emulated robot in this process, said loudly.
    ///
    /// # Errors
    /// Exit code 4 when several robots answer.
    pub fn port(&self) -> Outcome<PortUri> {
        Ok(self.found_port()?.unwrap_or_else(|| {
            self.out.warn(
                "NO ROBOT FOUND: using the EMULATED robot in this process. Nothing real will move. \
                 Give --port to choose one, or --port sim: to silence this.",
            );
            PortUri::Sim(None)
        }))
    }

    /// The port for a command that records, moves, stops or changes the robot. Without a person at a terminal who reads the warning,
    /// the emulated robot is only taken when it was named: a loose cable must not become a recording, nor a STOP that stops nothing.
    ///
    /// # Errors
    /// Exit code 4 when several robots answer, 2 when none does and nobody reads a warning.
    pub fn port_to_move(&self) -> Outcome<PortUri> {
        if std::io::stdin().is_terminal() {
            return self.port();
        }
        self.found_port()?.ok_or_else(|| {
            let message = "no robot was found, and a command that moves, changes or records one takes the emulated one only when it is named";
            Failure::say(Exit::Usage, message)
                .hint("give -p sim: for the emulated robot, or name the robot's port with -p; `rb-host doctor` looks for it")
        })
    }

    /// The port as set, or the only device that answers; `None` where there is none.
    fn found_port(&self) -> Outcome<Option<PortUri>> {
        let setting = self.settings.get(Key::Port);
        if !setting.value.is_empty() {
            self.out.detail(format_args!(
                "port {} (from {})",
                setting.value, setting.origin
            ));
            return setting
                .value
                .parse()
                .map(Some)
                .map_err(|e| Failure::new(Exit::Usage, anyhow::Error::new(e)));
        }
        let answered = self.probe();
        match answered.as_slice() {
            [] => Ok(None),
            [only] => {
                self.out.say(format_args!("port {}", only.path.display()));
                Ok(Some(only.uri()))
            }
            several => {
                let list: Vec<String> = several
                    .iter()
                    .map(|c| c.path.display().to_string())
                    .collect();
                let message = format!("{} robots answer: {}", several.len(), list.join(", "));
                Err(Failure::say(Exit::Port, message).hint("choose one with --port"))
            }
        }
    }

    fn probe(&self) -> Vec<Candidate> {
        let likely = find::candidates().into_iter().filter(Candidate::is_likely);
        let answers = |c: &Candidate| match find::probe(c, self.baud()) {
            Ok(_) => true,
            Err(LinkError::Version { .. }) => true,
            Err(error) => {
                self.out
                    .detail(format_args!("{}: {error}", c.path.display()));
                false
            }
        };
        likely.filter(answers).collect()
    }

    /// Opens the port and says HELLO.
    ///
    /// # Errors
    /// Exit codes 4, 5, 6.
    pub fn connect(&self) -> Outcome<Robot> {
        self.connect_to(&self.port()?)
    }

    /// Opens the port of [`Self::port_to_move`] and says HELLO.
    ///
    /// # Errors
    /// Exit codes 2, 4, 5, 6.
    pub fn connect_to_change(&self) -> Outcome<Robot> {
        self.connect_to(&self.port_to_move()?)
    }

    /// Opens a given port and says HELLO.
    ///
    /// # Errors
    /// Exit codes 4, 5, 6.
    pub fn connect_to(&self, uri: &PortUri) -> Outcome<Robot> {
        self.connect_over(link::open(uri, self.baud())?)
    }

    /// Says HELLO over an open link.
    ///
    /// # Errors
    /// Exit codes 5, 6.
    pub fn connect_over(&self, link: Box<dyn Link>) -> Outcome<Robot> {
        let uri = link.uri().clone();
        let mut robot = Robot::connect(link, self.timeout(), &self.keys())?;
        if uri.is_sim() {
            home_the_emulated(&mut robot)?;
        }
        let hello = robot.hello();
        self.out.detail(format_args!(
            "robot {} on {uri}, firmware {}",
            hello.robot_id, hello.firmware
        ));
        Ok(robot)
    }
}

/// The emulated robot is built in its home pose, so its zero can be taken at once. A real one is placed by hand.
fn home_the_emulated(robot: &mut Robot) -> Outcome {
    while robot.link().now() < EMULATED_START {
        robot.next(Duration::from_millis(50))?;
    }
    let info = robot.info()?;
    let joint_mask = robot.machine()?.all_joints();
    if info.state == ModuleState::Unhomed && info.motor_mask == joint_mask {
        robot.order(&ToModule::Zero {
            joint_mask,
            tag: Tag::NONE,
        })?;
    }
    Ok(())
}
