//! The verdict for people: as Markdown, and as one HTML file without network.
//!
//! One page serves a joint on a bench and a whole robot; they differ in the evidence and the replay alone.

mod joint;
mod markdown;
mod page;
mod plot;
mod regimes;
mod words;

pub use joint::html;
pub use markdown::markdown;
pub(crate) use page::{Evidence, html as page, table};
pub(crate) use plot::{Axes, Curve, plot};
pub(crate) use words::{escape, number};
