//! Bodies that overlap: what a place is within.

use super::{Boundary, MediumId};
use crate::math::Vec3;

/// The inside of a closed shape that has a priority. Where bodies overlap, the one with the highest holds, and the surfaces of the
/// others are not there (Schmidt and Budge 2002, "Simple nested dielectrics in ray traced images").
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// What fills it.
    pub medium: Option<MediumId>,
    /// Its index of refraction over that of empty space: that of its material, and 1 where that refracts nothing.
    pub index: f32,
}

/// Index of a body in [`super::Media::bodies`]: where several lie, the lowest index holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BodyId(pub u16);

/// Most bodies that a place is known to be within; of more, those that hold are kept.
const MOST_OVERLAPPING: usize = 6;

/// No body's index.
const NO_BODY: u16 = u16::MAX;

/// Most bodies of a scene.
pub(crate) const MOST_BODIES: u64 = NO_BODY as u64;

/// What a place lies in: a function of the place, whatever path has come there, where bodies are closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space {
    /// What is there outside of all bodies; `None` is empty space.
    pub(super) base: Option<MediumId>,
    /// The bodies that the place is within, in order, and [`NO_BODY`] behind them. One that overlaps itself is there as often as it does.
    bodies: [u16; MOST_OVERLAPPING],
}

/// What lies on the two sides of a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sides {
    interior: Space,
    exterior: Space,
}

impl Space {
    /// Within no body and no medium.
    pub(crate) const EMPTY: Self = Self::filled(None);

    /// Within no body.
    pub(crate) const fn filled(base: Option<MediumId>) -> Self {
        Self {
            base,
            bodies: [NO_BODY; MOST_OVERLAPPING],
        }
    }

    /// The body that holds.
    #[inline]
    pub(crate) fn holds(&self) -> Option<BodyId> {
        (self.bodies[0] != NO_BODY).then_some(BodyId(self.bodies[0]))
    }

    /// Within the same bodies.
    fn over(mut self, base: Option<MediumId>) -> Self {
        self.base = base;
        self
    }

    fn entered(mut self, body: BodyId) -> Self {
        let mut next = body.0;
        for place in &mut self.bodies {
            if next < *place {
                std::mem::swap(place, &mut next);
            }
        }
        self
    }

    fn left(mut self, body: BodyId) -> Self {
        if let Some(at) = self.bodies.iter().position(|within| *within == body.0) {
            self.bodies.copy_within(at + 1.., at);
            self.bodies[MOST_OVERLAPPING - 1] = NO_BODY;
        }
        self
    }
}

impl Sides {
    pub(crate) const NOTHING: Self = Self::within(Space::EMPTY);

    /// The same on both.
    pub(crate) const fn within(space: Space) -> Self {
        Self {
            interior: space,
            exterior: space,
        }
    }

    /// Of the surface of a body to which a path has come through `through`, out of the body or from outside.
    pub(super) fn of_body(body: BodyId, through: Space, comes_out: bool) -> Self {
        let exterior = match comes_out {
            true => through.left(body),
            false => through,
        };
        Self {
            interior: exterior.entered(body),
            exterior,
        }
    }

    /// Of a surface that says what media lie on its sides.
    pub(super) fn of_boundary(boundary: Boundary, through: Space) -> Self {
        Self {
            interior: through.over(boundary.interior),
            exterior: through.over(boundary.exterior),
        }
    }

    pub(super) fn exterior(&self) -> Space {
        self.exterior
    }

    /// What lies on the side to which `direction` leads from the surface of this normal.
    pub(crate) fn towards(&self, direction: Vec3, normal: Vec3) -> Space {
        match direction.dot(normal) > 0.0 {
            true => self.exterior,
            false => self.interior,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn within(bodies: &[u16]) -> Space {
        bodies
            .iter()
            .fold(Space::EMPTY, |space, body| space.entered(BodyId(*body)))
    }

    #[test]
    fn order_does_not_matter() {
        let expected = within(&[2, 5, 5, 9]);
        for bodies in [[5, 9, 2, 5], [9, 5, 5, 2], [5, 2, 5, 9]] {
            assert_eq!(within(&bodies), expected);
        }
        assert_eq!(expected.holds(), Some(BodyId(2)));
        let left = expected.left(BodyId(5)).left(BodyId(2));
        assert_eq!(left, within(&[9, 5]));
        assert_eq!(left.left(BodyId(7)), left);
        assert_eq!(left.left(BodyId(5)).left(BodyId(9)), Space::EMPTY);
        assert_eq!(Space::EMPTY.holds(), None);
    }

    #[test]
    fn of_too_many_those_that_hold_are_kept() {
        assert_eq!(within(&[7, 6, 5, 4, 3, 2, 1]), within(&[1, 2, 3, 4, 5, 6]));
        assert_eq!(within(&[1, 2, 3, 4, 5, 6, 7]), within(&[1, 2, 3, 4, 5, 6]));
    }
}
