//! Path expressions: which of all paths count, by what happens along them (Heckbert 1990), such as `L S+ D E` for caustics.
//!
//! A path is a word from the light to the camera: `L`, a letter for each surface, or place in a medium, that it scatters at, `E`. An expression is a regular
//! expression of such words. It is turned into the automaton whose states are the letters of the expression (Glushkov 1961): a set of
//! states is a byte, and a step along a path is a look into a table. A path from a light knows in which states it can be
//! after what has happened so far; one from the camera, in which states the rest must be, so that the word ends well. Where the two meet the word is
//! one of the expression's if the sets have a state in common.

use std::str::FromStr;
use thiserror::Error;

/// A set of states of an automaton. State 0 is that after `L`; a set of all is that of a scene of which all paths count.
pub(crate) type States = u8;

/// Every state.
pub(crate) const ANY: States = States::MAX;
/// The state after `L`, where a path has just left the light.
pub(crate) const AT_LIGHT: States = 1;
/// Most letters between `L` and `E`: as many as a set has states beside the first.
const MOST_LETTERS: usize = States::BITS as usize - 1;
/// Parentheses within parentheses.
const DEEPEST: usize = 16;

/// What happens at a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// `S`: a delta function of direction, as of mirrors and clear glass.
    Specular,
    /// `G`: a lobe too glossy for a density estimate.
    Glossy,
    /// `D`: any other lobe of a surface.
    Diffuse,
    /// `V`: a medium.
    Volume,
}

const EVENTS: [(char, Event); 4] = [
    ('S', Event::Specular),
    ('G', Event::Glossy),
    ('D', Event::Diffuse),
    ('V', Event::Volume),
];

/// A set of paths.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PathExpression {
    /// For each event and each state, the states after the event.
    next: [[States; States::BITS as usize]; EVENTS.len()],
    /// For each event and each state after it, the states before.
    previous: [[States; States::BITS as usize]; EVENTS.len()],
    /// The states before `E`.
    last: States,
}

/// Why text is no path expression.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("column {column}: {reason}")]
pub struct ExpressionError {
    /// Column, from 1.
    pub column: usize,
    /// In words.
    pub reason: &'static str,
}

impl PathExpression {
    /// The states before `E`: those of a path from the camera that has met nothing yet.
    pub(crate) fn at_camera(&self) -> States {
        self.last
    }

    /// The states of a light path after an event.
    pub(crate) fn after(&self, states: States, event: Event) -> States {
        union(&self.next[event as usize], states)
    }

    /// The states that a light path must be in before an event of which a camera path knows the states after it.
    pub(crate) fn before(&self, states: States, event: Event) -> States {
        union(&self.previous[event as usize], states)
    }
}

fn union(table: &[States; States::BITS as usize], states: States) -> States {
    let member = |(state, others): (usize, &States)| if states >> state & 1 == 1 { *others } else { 0 };
    table.iter().enumerate().map(member).fold(0, |all, some| all | some)
}

/// What is known of a part of an expression: the letters that its words begin and end with, and whether it has the empty word.
#[derive(Clone, Copy, Debug)]
struct Part {
    first: States,
    last: States,
    empty: bool,
}

struct Parser {
    /// Letters with their columns; blanks are left out.
    text: Vec<(usize, char)>,
    at: usize,
    depth: usize,
    /// The events of each letter, as bits; that of state 0 stands for `L`.
    letters: Vec<u8>,
    /// The letters that may follow each.
    follow: [States; States::BITS as usize],
}

impl FromStr for PathExpression {
    type Err = ExpressionError;

    fn from_str(text: &str) -> Result<Self, ExpressionError> {
        let letters = (1..).zip(text.chars()).filter(|(_, letter)| !letter.is_whitespace());
        let mut parser = Parser {
            text: letters.collect(),
            at: 0,
            depth: 0,
            letters: vec![0],
            follow: [0; States::BITS as usize],
        };
        parser.expect('L', "a path expression begins with `L`, the light")?;
        let middle = parser.choice()?;
        parser.expect(
            'E',
            "expected `S`, `G`, `D`, `V`, `.`, `[`, `(`, or `E`, the camera, at the end",
        )?;
        if parser.at < parser.text.len() {
            return Err(parser.error("nothing follows `E`, the camera"));
        }
        parser.follow[0] |= middle.first;
        let last = middle.last | if middle.empty { AT_LIGHT } else { 0 };
        Ok(parser.automaton(last))
    }
}

impl Parser {
    fn peek(&self) -> Option<char> {
        self.text.get(self.at).map(|(_, letter)| *letter)
    }

    fn error(&self, reason: &'static str) -> ExpressionError {
        let end = self.text.last().map_or(1, |(column, _)| column + 1);
        let column = self.text.get(self.at).map_or(end, |(column, _)| *column);
        ExpressionError { column, reason }
    }

    fn takes(&mut self, letter: char) -> bool {
        let found = self.peek() == Some(letter);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, letter: char, reason: &'static str) -> Result<(), ExpressionError> {
        match self.takes(letter) {
            true => Ok(()),
            false => Err(self.error(reason)),
        }
    }

    fn choice(&mut self) -> Result<Part, ExpressionError> {
        let mut all = self.sequence()?;
        while self.takes('|') {
            let other = self.sequence()?;
            all = Part {
                first: all.first | other.first,
                last: all.last | other.last,
                empty: all.empty || other.empty,
            };
        }
        Ok(all)
    }

    fn sequence(&mut self) -> Result<Part, ExpressionError> {
        let mut all = Part {
            first: 0,
            last: 0,
            empty: true,
        };
        while self.peek().is_some_and(begins_part) {
            let next = self.repeated()?;
            self.link(all.last, next.first);
            all = Part {
                first: all.first | if all.empty { next.first } else { 0 },
                last: next.last | if next.empty { all.last } else { 0 },
                empty: all.empty && next.empty,
            };
        }
        Ok(all)
    }

    fn repeated(&mut self) -> Result<Part, ExpressionError> {
        let mut part = self.single()?;
        loop {
            let (again, without) = match self.peek() {
                Some('*') => (true, true),
                Some('+') => (true, false),
                Some('?') => (false, true),
                _ => return Ok(part),
            };
            self.at += 1;
            if again {
                self.link(part.last, part.first);
            }
            part.empty |= without;
        }
    }

    fn single(&mut self) -> Result<Part, ExpressionError> {
        if self.takes('(') {
            if self.depth == DEEPEST {
                return Err(self.error("too many parentheses within each other"));
            }
            self.depth += 1;
            let part = self.choice()?;
            self.expect(')', "expected `)`")?;
            self.depth -= 1;
            return Ok(part);
        }
        if self.letters.len() > MOST_LETTERS {
            return Err(
                self.error("too many letters: at most 7 stand between `L` and `E`, where `.` and `[SG]` are one each")
            );
        }
        let events = match self.takes('[') {
            true => self.class()?,
            false => self
                .event()
                .ok_or_else(|| self.error("expected `S`, `G`, `D`, `V` or `.`"))?,
        };
        let state = 1 << self.letters.len();
        self.letters.push(events);
        Ok(Part {
            first: state,
            last: state,
            empty: false,
        })
    }

    fn class(&mut self) -> Result<u8, ExpressionError> {
        let mut events = 0;
        while !self.takes(']') {
            events |= self
                .event()
                .ok_or_else(|| self.error("expected `S`, `G`, `D`, `V` or `]`"))?;
        }
        match events {
            0 => Err(self.error("`[]` holds no letter")),
            events => Ok(events),
        }
    }

    /// The events of a letter, as bits.
    fn event(&mut self) -> Option<u8> {
        if self.takes('.') {
            return Some((1 << EVENTS.len()) - 1);
        }
        let (_, event) = EVENTS.into_iter().find(|(letter, _)| self.peek() == Some(*letter))?;
        self.at += 1;
        Some(1 << event as u8)
    }

    fn link(&mut self, from: States, to: States) {
        for (state, follow) in self.follow.iter_mut().enumerate() {
            if from >> state & 1 == 1 {
                *follow |= to;
            }
        }
    }

    fn automaton(&self, last: States) -> PathExpression {
        let mut expression = PathExpression {
            next: Default::default(),
            previous: Default::default(),
            last,
        };
        for (_, event) in EVENTS {
            let index = event as usize;
            let on_event = |(state, events): (usize, &u8)| (events >> index & 1) << state;
            let entered: States = self.letters.iter().enumerate().map(on_event).sum();
            for (state, follow) in self.follow.iter().enumerate() {
                let after = follow & entered;
                expression.next[index][state] = after;
                for (other, before) in expression.previous[index].iter_mut().enumerate() {
                    *before |= (after >> other & 1) << state;
                }
            }
        }
        expression
    }
}

/// Whether a letter, a class of letters or a parenthesis begins with this.
fn begins_part(letter: char) -> bool {
    ['.', '[', '('].contains(&letter) || EVENTS.iter().any(|(known, _)| *known == letter)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(letter: char) -> Event {
        EVENTS.into_iter().find(|(known, _)| *known == letter).unwrap().1
    }

    /// Whether a word between `L` and `E` is one of the expression's, told at each place where the two sides may meet.
    fn holds(expression: &PathExpression, word: &str) -> bool {
        let letters: Vec<Event> = word.chars().map(of).collect();
        let told: Vec<bool> = (0..=letters.len())
            .map(|place| {
                let (light, camera) = letters.split_at(place);
                let forward = light
                    .iter()
                    .fold(AT_LIGHT, |states, event| expression.after(states, *event));
                let backward = camera.iter().rfold(expression.at_camera(), |states, event| {
                    expression.before(states, *event)
                });
                forward & backward != 0
            })
            .collect();
        assert!(told.iter().all(|one| *one == told[0]), "{word}: {told:?}");
        told[0]
    }

    /// All words of up to four letters.
    fn words() -> impl Iterator<Item = String> {
        (0..=4).flat_map(|length| {
            (0..EVENTS.len().pow(length)).map(move |number| {
                let letter = |place: u32| EVENTS[number / EVENTS.len().pow(place) % EVENTS.len()].0;
                (0..length).map(letter).collect()
            })
        })
    }

    #[test]
    fn words_are_those_of_the_expression() {
        let is = |text: &str, expected: fn(&str) -> bool| {
            let expression: PathExpression = text.parse().unwrap();
            for word in words() {
                assert_eq!(holds(&expression, &word), expected(&word), "{text}: {word}");
            }
        };
        is("L E", |word| word.is_empty());
        is("LDE", |word| word == "D");
        is("L S+ D E", |word| {
            word.len() >= 2 && word.ends_with('D') && word[..word.len() - 1].chars().all(|letter| letter == 'S')
        });
        is("L .* E", |_| true);
        is("L [SG]* E", |word| !word.contains(['D', 'V']));
        is("L V .* V E", |word| {
            word.len() >= 2 && word.starts_with('V') && word.ends_with('V')
        });
        is("L (D|S G)+ E", |word| {
            let rest = word.replace("SG", "");
            !word.is_empty() && rest.chars().all(|letter| letter == 'D') && !word.contains("SGG")
        });
        is("L D? S? E", |word| ["", "D", "S", "DS"].contains(&word));
        is("L (D (S | G))* E", |word| {
            word.len().is_multiple_of(2)
                && word
                    .as_bytes()
                    .chunks(2)
                    .all(|pair| pair[0] == b'D' && b"SG".contains(&pair[1]))
        });
        is("L .* S .* E", |word| word.contains('S'));
    }

    #[test]
    fn what_is_no_expression_is_told_with_its_column() {
        let refused = |text: &str| text.parse::<PathExpression>().unwrap_err();
        for (text, column) in [
            ("", 1),
            ("D E", 1),
            ("L D", 4),
            ("L D E E", 7),
            ("L X E", 3),
            ("L * E", 3),
            ("L (D E", 6),
            ("L [] E", 6),
            ("L [SX] E", 5),
            ("L D D D D D D D D E", 17),
            ("L D+|| E x", 10),
        ] {
            assert_eq!(refused(text).column, column, "{text}: {}", refused(text));
        }
        let deep = format!("L {}D{} E", "(".repeat(30), ")".repeat(30));
        assert!(refused(&deep).reason.contains("parentheses"));
        assert!("L D D D D D D D E".parse::<PathExpression>().is_ok());
    }
}
