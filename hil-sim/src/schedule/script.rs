//! What the people of a schedule do: bring the robot up, upload, start, watch, change, stop, take the record home.

use super::desk::{Fail, Hand, Note};
use super::gaits;
use protocol::link::{
    Digest, EndReason, FromModule, Info, ModuleState, Tag, TelemetryRate, ToModule, WireGait,
};

/// Every joint.
const ALL: u16 = 63;
/// Pause after a failure, us.
const PAUSE_US: u64 = 150_000;

/// What a run is to be like.
#[derive(Debug, Clone, Copy)]
struct Wish {
    slot: u8,
    digest: Digest,
    duration_ms: u32,
    lease_ms: Option<u16>,
    rate: TelemetryRate,
    countdown_ms: u16,
}

impl Wish {
    fn order(&self) -> ToModule {
        let Self {
            slot,
            digest,
            duration_ms,
            lease_ms,
            rate,
            countdown_ms,
        } = *self;
        let tag = Tag::NONE;
        match lease_ms {
            None => ToModule::Start {
                slot,
                digest,
                duration_ms,
                rate,
                countdown_ms,
                tag,
            },
            Some(lease_ms) => ToModule::StartTethered {
                slot,
                digest,
                duration_ms,
                rate,
                countdown_ms,
                lease_ms,
                tag,
            },
        }
    }
}

impl Hand {
    fn below(&self, n: u64) -> u64 {
        self.0.borrow_mut().rng.next_u64() % n
    }

    fn chance(&self, probability: f64) -> bool {
        self.0.borrow_mut().rng.chance(probability)
    }

    async fn info(&self) -> Result<Info, Fail> {
        match self.ask(&ToModule::GetInfo).await? {
            FromModule::Info(info) => Ok(info),
            _ => Err(Fail::Unexpected),
        }
    }

    /// What is in a slot.
    async fn digest(&self, slot: u8) -> Result<Option<Digest>, Fail> {
        match self.ask(&ToModule::ListSlots).await? {
            FromModule::Slots { slots, .. } => Ok(slots
                .get(usize::from(slot))
                .and_then(|held| held.as_ref().map(|held| held.digest))),
            _ => Err(Fail::Unexpected),
        }
    }

    /// From any state at rest to Idle, as the pages tell a user to do it.
    async fn bring_up(&self) -> Result<(), Fail> {
        self.hello().await?;
        let tag = Tag::NONE;
        for _ in 0..30 {
            match self.info().await?.state {
                ModuleState::Idle => return Ok(()),
                ModuleState::Fault | ModuleState::EStop => {
                    self.ask(&ToModule::ClearFault { tag }).await?;
                }
                ModuleState::Unhomed => {
                    // Until the joints turn freely.
                    self.sleep(150_000).await;
                    self.0.borrow_mut().place = true;
                    // Two cycles, so that the module has read the drivers where they stand now.
                    self.sleep(120_000).await;
                    let joint_mask = ALL;
                    self.ask(&ToModule::Zero { joint_mask, tag }).await?;
                }
                ModuleState::Armed | ModuleState::Run | ModuleState::Stopping => {
                    self.sleep(500_000).await;
                }
                ModuleState::Boot => self.sleep(50_000).await,
            }
        }
        Err(Fail::Timeout)
    }

    async fn upload(&self, slot: u8, number: usize) -> Result<Digest, Fail> {
        let gait = WireGait::from(gaits::gait(number));
        let want = gait.digest();
        self.0.borrow_mut().notes.push(Note::Uploading(slot, want));
        let answer = self
            .ask(&ToModule::PutGait {
                slot,
                activate: self.chance(0.3),
                gait,
                tag: Tag::NONE,
            })
            .await?;
        let FromModule::GaitStored { digest, .. } = answer else {
            return Err(Fail::Unexpected);
        };
        self.0.borrow_mut().notes.push(Note::Stored(slot, digest));
        Ok(digest)
    }

    async fn wish(&self) -> Result<Wish, Fail> {
        let slot = self.below(2) as u8;
        let mut digest = self.digest(slot).await?;
        if digest.is_none() || self.chance(0.4) {
            let number = self.below(gaits::COUNT as u64) as usize;
            digest = Some(self.upload(slot, number).await?);
        }
        let lease_ms = self.chance(0.5).then(|| 150 + self.below(900) as u16);
        let rates = [
            TelemetryRate::Cycle,
            TelemetryRate::Fast,
            TelemetryRate::Off,
        ];
        Ok(Wish {
            slot,
            digest: digest.ok_or(Fail::Unexpected)?,
            duration_ms: 200 + self.below(3_000) as u32,
            lease_ms,
            rate: rates[self.below(3) as usize],
            countdown_ms: [0, 130][self.below(2) as usize],
        })
    }

    /// Watches a run to its end; a heartbeat in time, now and then a change of gait or a STOP.
    async fn watch(&self, wish: &Wish) -> Result<(), Fail> {
        let before = self.0.borrow().ends.len();
        let beat_us = wish
            .lease_ms
            .map_or(400_000, |ms| u64::from(ms) * 1_000 / 4);
        for _ in 0..400 {
            if self.0.borrow().ends.len() > before {
                return Ok(());
            }
            self.sleep(beat_us).await;
            let tag = Tag::NONE;
            if wish.lease_ms.is_some() {
                self.beat().await?;
            }
            if self.chance(0.04) {
                self.stop().await;
            } else if self.chance(0.06) {
                let slot = 1 - wish.slot;
                if let Some(digest) = self.digest(slot).await? {
                    let change = ToModule::ChangeGait { slot, digest, tag };
                    unless_restarted(&self.ask(&change).await)?;
                }
            } else if wish.lease_ms.is_none() {
                let state = self.info().await?.state;
                let over = !matches!(
                    state,
                    ModuleState::Armed | ModuleState::Run | ModuleState::Stopping
                );
                if over {
                    return Ok(());
                }
            }
        }
        Err(Fail::Timeout)
    }

    /// A heartbeat. The run may be over, and then there is nothing to keep alive.
    async fn beat(&self) -> Result<(), Fail> {
        let tag = Tag::NONE;
        unless_restarted(&self.ask(&ToModule::Heartbeat { tag }).await)
    }

    async fn once(&self) -> Result<(), Fail> {
        let hasty = self.0.borrow().hasty;
        if hasty && self.chance(0.5) {
            self.hello().await?;
        } else {
            self.bring_up().await?;
        }
        let wish = self.wish().await?;
        self.ask(&wish.order()).await?;
        self.watch(&wish).await?;
        if wish.rate != TelemetryRate::Off {
            self.drain().await?;
        }
        Ok(())
    }

    /// The owner: one run after the other, whatever happens.
    pub(crate) async fn owner(self) {
        // A program is not started at the same instant every day.
        let wait_us = 20_000 + self.below(300_000);
        self.sleep(wait_us).await;
        loop {
            if self.once().await.is_err() {
                self.sleep(PAUSE_US).await;
            }
        }
    }

    /// Somebody else: looks, stops, starts if he may.
    pub(crate) async fn visitor(self) {
        loop {
            let wait_us = 30_000 + self.below(500_000);
            self.sleep(wait_us).await;
            let rate = [TelemetryRate::Off, TelemetryRate::Fast][self.below(2) as usize];
            let from_sample = self.below(40) as u32;
            // Whatever comes of it: the laws hold all the same.
            let _ = match self.below(8) {
                0 => self.hello().await.map(|()| FromModule::Crash(None)),
                1 => self.ask(&ToModule::GetChallenge).await,
                2 => self.ask(&ToModule::Subscribe { rate }).await,
                3 => self.ask(&ToModule::Drain { from_sample }).await,
                4 => self.ask(&ToModule::GetEvents { since: 0 }).await,
                5 if self.stop().await => Err(Fail::Timeout),
                6 => match self.wish().await {
                    Ok(wish) => self.ask(&wish.order()).await,
                    Err(fail) => Err(fail),
                },
                _ => self.info().await.map(FromModule::Info),
            };
        }
    }

    /// After the faults: a run to its end, with its record. The robot is as good as new, so nothing of it may fail
    /// twice.
    pub(crate) async fn comes_back(self) {
        for _ in 0..2 {
            if self.last_run().await.is_ok() {
                return;
            }
            self.sleep(PAUSE_US).await;
        }
    }

    async fn last_run(&self) -> Result<(), Fail> {
        self.bring_up().await?;
        let digest = self.upload(1, 0).await?;
        let wish = Wish {
            slot: 1,
            digest,
            duration_ms: 600,
            lease_ms: Some(900),
            rate: TelemetryRate::Cycle,
            countdown_ms: 0,
        };
        let before = self.0.borrow().ends.len();
        self.ask(&wish.order()).await?;
        while self.0.borrow().ends.len() == before {
            self.sleep(200_000).await;
            self.beat().await?;
        }
        let end = self.0.borrow().ends.last().copied();
        let end = end.filter(|end| end.reason == EndReason::Completed);
        self.drain().await?;
        let note = Note::Completed(end.ok_or(Fail::Unexpected)?, wish.duration_ms);
        self.0.borrow_mut().notes.push(note);
        Ok(())
    }
}

/// A module that has restarted tells no end of the run before: whoever waits for it gives up, as `rb-host` does. Any other answer may stand.
fn unless_restarted(answer: &Result<FromModule, Fail>) -> Result<(), Fail> {
    match answer {
        Err(Fail::Restarted) => Err(Fail::Restarted),
        _ => Ok(()),
    }
}
