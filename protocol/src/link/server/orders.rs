//! Orders from their bytes to the calls that carry them out.

use super::handler::{Completed, ModuleHandler, Outcome, StartOrder};
use crate::link::message::ToModule;
use crate::link::reject::Reject;

/// State-changing requests. `None`: begun.
pub(super) fn carry_out<H: ModuleHandler>(
    message: &ToModule,
    handler: &mut H,
) -> Result<Option<Completed>, Reject> {
    match message {
        ToModule::PutGait {
            slot,
            activate,
            gait,
            ..
        } => Ok(match handler.put_gait(*slot, *activate, gait)? {
            Outcome::Done(stored) => Some(Completed::GaitStored(stored)),
            Outcome::Pending => None,
        }),
        ToModule::ActivateSlot { slot, .. } => handler.activate_slot(*slot).map(Into::into),
        ToModule::EraseSlot { slot, .. } => handler.erase_slot(*slot).map(Into::into),
        ToModule::Start {
            slot,
            digest,
            duration_ms,
            rate,
            countdown_ms,
            ..
        }
        | ToModule::StartTethered {
            slot,
            digest,
            duration_ms,
            rate,
            countdown_ms,
            ..
        } => handler
            .start(&StartOrder {
                slot: *slot,
                digest: *digest,
                duration_ms: *duration_ms,
                rate: *rate,
                countdown_ms: *countdown_ms,
                lease_ms: match message {
                    ToModule::StartTethered { lease_ms, .. } => Some(*lease_ms),
                    _ => None,
                },
            })
            .map(Into::into),
        ToModule::Heartbeat { .. } => handler.heartbeat().map(Into::into),
        ToModule::ChangeGait { slot, digest, .. } => {
            handler.change_gait(*slot, *digest).map(Into::into)
        }
        ToModule::SetDrivers { profile, .. } => handler.set_drivers(*profile).map(Into::into),
        ToModule::SetRobot { robot, .. } => handler.set_robot(robot).map(Into::into),
        ToModule::ClearFault { .. } => handler.clear_fault().map(Into::into),
        ToModule::Zero { joint_mask, .. } => handler.zero(*joint_mask).map(Into::into),
        ToModule::BusRaw {
            bytes, listen_ms, ..
        } => Ok(match handler.bus_raw(bytes, *listen_ms)? {
            Outcome::Done(answer) => Some(Completed::Bus(answer)),
            Outcome::Pending => None,
        }),
        ToModule::SetKey { key } => handler.set_key(key).map(Into::into),
        ToModule::Reset { .. } => handler.reset().map(Into::into),
        ToModule::Hello { .. }
        | ToModule::GetInfo
        | ToModule::GetChallenge
        | ToModule::GetGait { .. }
        | ToModule::ListSlots
        | ToModule::Stop
        | ToModule::Ping { .. }
        | ToModule::Subscribe { .. }
        | ToModule::GetEvents { .. }
        | ToModule::Drain { .. }
        | ToModule::ProveState { .. }
        | ToModule::GetDrivers
        | ToModule::GetRobot
        | ToModule::GetCrash => Err(Reject::Unsupported),
    }
}
