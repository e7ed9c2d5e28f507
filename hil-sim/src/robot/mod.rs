//! The whole robot without hardware: the firmware's own tasks on a virtual clock, over emulated bus, motors, link and flash.
//!
//! ```text
//! client ── LinkLine ──▶ firmware::tasks::run ──▶ BusEnd ──▶ World (motors) or IdealMotors
//!                             │        ▲
//!                             ▼        │ VirtualClock, Executor: one thread, no real time
//!                          RamFlash, EmulatedBoard
//! ```
//!
//! Time only moves in [`EmulatedRobot::run_until`]. Equal calls give equal bytes.

pub mod board;
pub mod executor;
pub mod flash;
pub mod host;
pub mod ideal;
pub mod link;
pub mod serve;
pub mod wire;

use board::{BoardOfOneBoot, EmulatedBoard};
use control::motion::MotionParams;
use executor::{Executor, VirtualClock};
use firmware::app::App;
use firmware::ports::{
    Clock, FlashError, LinkKind, LinkPort, NotFitted, ResetCause, SlotStore, WORD_BYTES,
};
use flash::RamFlash;
use ideal::IdealMotors;
use link::LinkLine;
use std::cell::RefCell;
use std::rc::Rc;
use wire::{BusEnd, MotorBus};

/// How a robot is set up.
#[derive(Debug, Clone, Copy)]
pub struct Setup {
    /// Seed of board entropy and flash tears.
    pub seed: u64,
    /// Byte time of both host links, ns; 0 = bytes take no time.
    pub link_byte_ns: u64,
    /// Robot model and pre-check margins.
    pub motion: MotionParams,
    /// Whether the second link, a radio, is fitted. The first one is a cable.
    pub radio: bool,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            seed: 0,
            link_byte_ns: link::BYTE_NS_115200,
            motion: MotionParams::default(),
            radio: false,
        }
    }
}

/// A robot on the desk that is not there.
pub struct EmulatedRobot<M: MotorBus + 'static = IdealMotors> {
    setup: Setup,
    executor: Executor,
    clock: VirtualClock,
    motors: Rc<RefCell<M>>,
    flash: SharedFlash,
    board: EmulatedBoard,
    wire: LinkLine,
    radio: LinkLine,
    resets: u32,
}

impl EmulatedRobot<IdealMotors> {
    /// A robot with ideal drivers, one for each of its joints, just powered.
    #[must_use]
    pub fn ideal(setup: Setup) -> Self {
        let joints = setup.motion.machine().joints();
        Self::with_motors(setup, IdealMotors::of(joints, false))
    }
}

impl<M: MotorBus + 'static> EmulatedRobot<M> {
    /// A robot on the given motors, just powered.
    #[must_use]
    pub fn with_motors(setup: Setup, motors: M) -> Self {
        Self::with_flash(setup, motors, RamFlash::new(setup.seed))
    }

    /// A robot on the given motors with the flash of an earlier life, just powered.
    #[must_use]
    pub fn with_flash(setup: Setup, motors: M, flash: RamFlash) -> Self {
        let executor = Executor::new();
        let clock = executor.clock();
        let mut robot = Self {
            setup,
            motors: Rc::new(RefCell::new(motors)),
            flash: SharedFlash(Rc::new(RefCell::new(flash))),
            board: EmulatedBoard::new(clock.clone(), setup.seed),
            wire: LinkLine::new(clock.clone(), setup.link_byte_ns),
            radio: LinkLine::new(clock.clone(), setup.link_byte_ns),
            executor,
            clock,
            resets: 0,
        };
        robot.boot(ResetCause::PowerOn);
        robot
    }

    /// Virtual time since power-up, us. It goes on over resets of the processor.
    #[must_use]
    pub fn now_us(&self) -> u64 {
        self.clock.now_us()
    }

    /// The cable.
    #[must_use]
    pub fn link(&self) -> LinkLine {
        self.wire.clone()
    }

    /// The radio; nothing answers unless [`Setup::radio`] is set.
    #[must_use]
    pub fn radio(&self) -> LinkLine {
        self.radio.clone()
    }

    /// Battery, STOP input, watchdog.
    #[must_use]
    pub fn board(&self) -> &EmulatedBoard {
        &self.board
    }

    /// The flash, to look at or to cut.
    #[must_use]
    pub fn flash(&self) -> &RefCell<RamFlash> {
        &self.flash.0
    }

    /// The motors, as they are now.
    #[must_use]
    pub fn motors(&self) -> &RefCell<M> {
        &self.motors
    }

    /// Resets of the processor so far.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.resets
    }

    /// Polls of the firmware's future so far.
    #[must_use]
    pub fn polls(&self) -> u64 {
        self.executor.polls()
    }

    /// Resets the processor now, wherever its tasks stand. Motors go on.
    pub fn reset(&mut self, cause: ResetCause) {
        self.resets += 1;
        self.wire.module_reset();
        self.radio.module_reset();
        self.boot(cause);
    }

    /// Runs to virtual time `until_us`.
    pub fn run_until(&mut self, until_us: u64) {
        self.advance(until_us, || false);
    }

    /// Runs for `us` of virtual time.
    pub fn run_for(&mut self, us: u64) {
        self.run_until(self.now_us() + us);
    }

    /// Runs to `until_us`, or until bytes wait for the client on the cable.
    pub fn run_until_readable(&mut self, until_us: u64) {
        let line = self.wire.clone();
        self.advance(until_us, move || line.readable());
    }

    /// Runs to `until_us`, or until the power of the flash has failed.
    pub fn run_until_cut(&mut self, until_us: u64) {
        let flash = self.flash.clone();
        self.advance(until_us, move || !flash.0.borrow().is_powered());
    }

    fn advance(&mut self, until_us: u64, ready: impl Fn() -> bool) {
        loop {
            let bite_us = self.board.watchdog_us();
            let board = self.board.clone();
            self.executor.run_until(until_us.min(bite_us), || {
                board.wants_reset().is_some() || ready()
            });
            match self.board.wants_reset() {
                Some(cause) => self.reset(cause),
                None if self.now_us() >= until_us || ready() => break,
                None => {}
            }
        }
        // The motors move on with time, whether or not the firmware listens.
        self.motors.borrow_mut().advance(self.now_us() * 1000);
    }

    fn boot(&mut self, cause: ResetCause) {
        let motors = self.motors.clone();
        let board = self
            .board
            .restart(cause, Rc::new(move || motors.borrow().battery_mv()));
        let clock = self.clock.clone();
        let bus = BusEnd::new(clock.clone(), self.motors.clone());
        let mut app = Box::new(App::new(self.setup.motion));
        let wire = self.wire.clone();
        let radio = self.setup.radio.then(|| self.radio.clone());
        let flash = self.flash.clone();
        self.executor.spawn(async move {
            let BootParts {
                clock,
                mut bus,
                mut flash,
                mut board,
            } = BootParts {
                clock,
                bus,
                flash,
                board,
            };
            let first = LinkPort {
                kind: LinkKind::Wire,
                rx: wire.clone(),
                tx: wire,
            };
            match radio {
                Some(radio) => {
                    let second = LinkPort {
                        kind: LinkKind::Radio,
                        rx: radio.clone(),
                        tx: radio,
                    };
                    firmware::tasks::run(
                        &mut app, &clock, &mut bus, &mut flash, &mut board, first, second,
                    )
                    .await;
                }
                None => {
                    let second = LinkPort {
                        kind: LinkKind::Radio,
                        rx: NotFitted,
                        tx: NotFitted,
                    };
                    firmware::tasks::run(
                        &mut app, &clock, &mut bus, &mut flash, &mut board, first, second,
                    )
                    .await;
                }
            }
        });
    }
}

/// What one life of the firmware owns.
struct BootParts<M> {
    clock: VirtualClock,
    bus: BusEnd<M>,
    flash: SharedFlash,
    board: BoardOfOneBoot,
}

/// The flash outlives the firmware that writes it.
#[derive(Debug, Clone)]
struct SharedFlash(Rc<RefCell<RamFlash>>);

impl SlotStore for SharedFlash {
    fn erase(&mut self, page: usize) -> Result<(), FlashError> {
        self.0.borrow_mut().erase(page)
    }

    fn program(
        &mut self,
        page: usize,
        word: usize,
        bytes: &[u8; WORD_BYTES],
    ) -> Result<(), FlashError> {
        self.0.borrow_mut().program(page, word, bytes)
    }

    fn read(&mut self, page: usize, word: usize) -> Result<[u8; WORD_BYTES], FlashError> {
        self.0.borrow_mut().read(page, word)
    }
}
