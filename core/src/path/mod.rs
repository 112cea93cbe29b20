//! Subpaths, from the camera or from a light: their walk, their vertices, the rays between these, and the shares of techniques.
//!
//! A subpath is a [`Walk`]: it traces an edge, makes a [`Vertex`] of what the edge ends at, a surface or a place in a medium, and goes on in a direction sampled
//! there. A [`PathExpression`] says which paths count, where not all do. What is found at a vertex, and what it is connected or merged with, is the integrator's business.

mod expression;
mod mis;
mod tracer;
mod vertex;
mod walk;

pub use expression::ExpressionError;
pub(crate) use expression::{ANY, AT_LIGHT, Event, PathExpression, States};
pub(crate) use mis::{Edges, Partial, power_heuristic};
pub(crate) use tracer::{Passed, Piece, Tracer};
pub(crate) use vertex::{Scattered, Towards, Vertex, Way};
pub(crate) use walk::{Crossed, Met, Walk};
