//! The verdict for people: as Markdown, and as one HTML file without network.
//!
//! One page serves a joint on a bench and a whole robot; they differ in the evidence and the replay alone.

mod joint;
mod markdown;
mod page;
mod place;
mod plot;
mod regimes;
mod stairs;
mod style;
mod subject;
pub(crate) mod words;

pub use joint::html;
pub use markdown::markdown;
pub(crate) use page::table;
pub use page::{Evidence, html as page};
pub(crate) use plot::{Axes, Curve, plot};
pub use subject::Subject;
pub(crate) use words::{escape, number};
