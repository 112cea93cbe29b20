//! Parameters: `<default name="spp" value="16"/>`, used as `$spp` inside any attribute's value.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

/// Values of parameters. Those given from outside win over the file's `<default>`s.
#[derive(Debug)]
pub(super) struct Parameters {
    values: BTreeMap<String, String>,
    /// Names given from outside that no `<default>` has named yet.
    unnamed: BTreeSet<String>,
    /// Names that some value was filled in for.
    used: RefCell<BTreeSet<String>>,
}

/// The longest name of a parameter \[characters\].
pub(super) const LONGEST_NAME: usize = 64;

/// Why a value cannot be filled in.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum FillError {
    /// `$name` with no such parameter.
    Undefined(String),
    /// The result is over the limit.
    TooLong,
}

impl Parameters {
    pub(super) fn new(defines: &BTreeMap<String, String>) -> Self {
        Self {
            values: defines.clone(),
            unnamed: defines.keys().cloned().collect(),
            used: RefCell::default(),
        }
    }

    pub(super) fn set_default(&mut self, name: &str, value: &str) {
        self.unnamed.remove(name);
        self.values.entry(name.to_owned()).or_insert_with(|| value.to_owned());
    }

    /// A name given from outside that no `<default>` names.
    pub(super) fn first_unnamed(&self) -> Option<&str> {
        self.unnamed.first().map(String::as_str)
    }

    /// Parameters that nothing uses.
    pub(super) fn unused(&self) -> Vec<String> {
        let used = self.used.borrow();
        self.values
            .keys()
            .filter(|name| !used.contains(*name))
            .cloned()
            .collect()
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.values.keys().map(String::as_str)
    }

    /// `text` with each `$name` replaced by the longest parameter name that fits; `\$` stands for a dollar sign.
    pub(super) fn fill(&self, text: &str, max_bytes: usize) -> Result<String, FillError> {
        let mut filled = String::new();
        let mut rest = text;
        while let Some(at) = rest.find('$') {
            let (before, after) = (&rest[..at], &rest[at + 1..]);
            if let Some(before) = before.strip_suffix('\\') {
                filled.push_str(before);
                filled.push('$');
                rest = after;
            } else {
                filled.push_str(before);
                let (name, value) = self
                    .longest(after)
                    .ok_or_else(|| FillError::Undefined(identifier(after)))?;
                filled.push_str(value);
                if !self.used.borrow().contains(name) {
                    self.used.borrow_mut().insert(name.to_owned());
                }
                rest = &after[name.len()..];
            }
            if filled.len() > max_bytes {
                return Err(FillError::TooLong);
            }
        }
        filled.push_str(rest);
        if filled.len() > max_bytes {
            Err(FillError::TooLong)
        } else {
            Ok(filled)
        }
    }

    fn longest(&self, text: &str) -> Option<(&str, &str)> {
        let ends = text.char_indices().map(|(start, c)| start + c.len_utf8());
        let ends: Vec<usize> = ends.take(LONGEST_NAME).collect();
        let found = ends
            .iter()
            .rev()
            .find_map(|end| self.values.get_key_value(&text[..*end]));
        found.map(|(name, value)| (name.as_str(), value.as_str()))
    }
}

fn identifier(text: &str) -> String {
    text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_name_wins_and_dollars_can_be_escaped() {
        let mut parameters = Parameters::new(&BTreeMap::from([("res".into(), "7".into())]));
        parameters.set_default("resx", "8");
        parameters.set_default("res", "9");
        assert_eq!(parameters.fill("a$resx,$res\\$res$resy", 100), Ok("a8,7$res7y".into()));
        assert_eq!(parameters.fill("x $spp", 100), Err(FillError::Undefined("spp".into())));
        assert_eq!(parameters.fill("$res$res", 1), Err(FillError::TooLong));
        assert_eq!(parameters.first_unnamed(), None);
    }

    #[test]
    fn a_name_from_outside_without_a_default_is_noticed() {
        let parameters = Parameters::new(&BTreeMap::from([("spp".into(), "7".into())]));
        assert_eq!(parameters.first_unnamed(), Some("spp"));
    }
}
