//! Numbers in texts.
//!
//! Meshes in text are nearly all numbers, and most of these are short. Where the digits fit 53 bits and the power of ten is exact, one
//! multiplication or division rounds correctly (Clinger 1990, "How to Read Floating Point Numbers Accurately"); others go to the
//! standard library.

/// The powers of ten that are exact in double precision.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// A decimal number as it is written: `digits` times ten to the power of `exponent`.
struct Decimal {
    negative: bool,
    /// Only right where there are at most 19.
    digits: u64,
    count: usize,
    exponent: i64,
    /// Bytes of the text.
    length: usize,
}

impl Decimal {
    /// The number at the start of `text`; what follows it is not looked at.
    #[inline(always)]
    fn leading(text: &[u8]) -> Option<Self> {
        let negative = text.first() == Some(&b'-');
        let mut at = usize::from(negative || text.first() == Some(&b'+'));
        let mut digits: u64 = 0;
        let start = at;
        scan(text, &mut at, |digit| {
            digits = digits.wrapping_mul(10).wrapping_add(digit)
        });
        let mut count = at - start;
        let mut exponent = 0;
        if text.get(at) == Some(&b'.') {
            at += 1;
            let start = at;
            scan(text, &mut at, |digit| {
                digits = digits.wrapping_mul(10).wrapping_add(digit)
            });
            count += at - start;
            exponent = -((at - start) as i64);
        }
        if count == 0 {
            return None;
        }
        if matches!(text.get(at), Some(b'e' | b'E')) {
            let minus = text.get(at + 1) == Some(&b'-');
            at += 1 + usize::from(minus || text.get(at + 1) == Some(&b'+'));
            let start = at;
            let mut written: i64 = 0;
            // Beyond these powers everything is zero or infinite.
            scan(text, &mut at, |digit| {
                written = (written * 10 + digit as i64).min(1 << 20)
            });
            if at == start {
                return None;
            }
            exponent += if minus { -written } else { written };
        }
        Some(Self {
            negative,
            digits,
            count,
            exponent,
            length: at,
        })
    }

    /// The number, where one operation gives it correctly rounded to double precision.
    #[inline(always)]
    fn exact(&self) -> Option<f64> {
        let power = EXACT_POWERS.get(self.exponent.unsigned_abs() as usize)?;
        if self.count > 19 || self.digits > 1 << 53 {
            return None;
        }
        let size = match self.exponent < 0 {
            true => self.digits as f64 / power,
            false => self.digits as f64 * power,
        };
        Some(if self.negative { -size } else { size })
    }
}

/// Gives the digits at `at` to `add`, and moves `at` behind them.
#[inline(always)]
fn scan(text: &[u8], at: &mut usize, mut add: impl FnMut(u64)) {
    while let Some(digit) = text
        .get(*at)
        .map(|byte| byte.wrapping_sub(b'0'))
        .filter(|digit| *digit < 10)
    {
        add(u64::from(digit));
        *at += 1;
    }
}

/// The number of one to nine digits at the start of `text`, as most indices of meshes are, and its length; `None` where there are none,
/// or more.
#[inline(always)]
pub(super) fn leading_digits(text: &[u8]) -> Option<(u32, usize)> {
    let (mut number, mut at) = (0_u64, 0);
    scan(&text[..text.len().min(10)], &mut at, |digit| {
        number = number * 10 + digit
    });
    (1..10).contains(&at).then_some((number as u32, at))
}

/// The number at the start of `text`, correctly rounded to double precision, and its length; `None` where there is none.
#[inline(always)]
pub(super) fn leading_f64(text: &[u8]) -> Option<(f64, usize)> {
    let decimal = Decimal::leading(text)?;
    let value = match decimal.exact() {
        Some(value) => value,
        None => std::str::from_utf8(&text[..decimal.length]).ok()?.parse().ok()?,
    };
    Some((value, decimal.length))
}

/// As [`leading_f64`], correctly rounded to single precision.
#[inline(always)]
pub(super) fn leading_f32(text: &[u8]) -> Option<(f32, usize)> {
    let decimal = Decimal::leading(text)?;
    let value = match decimal.exact().filter(|value| rounds_once(*value)) {
        Some(value) => value as f32,
        None => std::str::from_utf8(&text[..decimal.length]).ok()?.parse().ok()?,
    };
    Some((value, decimal.length))
}

/// Whether rounding to single precision gives what rounding the written number at once would give. Rounding keeps the order of
/// numbers, so the two differ only where `value` lies halfway between two numbers of single precision. Of these, the ones below
/// the normal range lie closer together; all that is there is left to the standard library.
#[inline(always)]
fn rounds_once(value: f64) -> bool {
    const DROPPED: u64 = (1 << 29) - 1;
    let size = value.abs();
    let normal = size >= f64::from(f32::MIN_POSITIVE) && size <= f64::from(f32::MAX);
    value == 0.0 || (normal && value.to_bits() & DROPPED != 1 << 28)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXTS: [&str; 19] = [
        "0",
        "-0",
        "+7",
        "1.",
        ".5",
        "-.25",
        "0.1",
        "1e3",
        "1E-7",
        "3.14159265358979",
        "123456789012345678",
        "9007199254740993",
        "1e22",
        "1e23",
        "8.5e-23",
        "0.00000000000000000000000000012",
        "1.7976931348623157e30",
        "1e-400",
        "00000000000000000000001.5",
    ];

    fn agree(text: &str) {
        let double: f64 = text.parse().unwrap();
        let (value, length) = leading_f64(text.as_bytes()).expect(text);
        assert_eq!((value.to_bits(), length), (double.to_bits(), text.len()), "{text}");
        let single: f32 = text.parse().unwrap();
        let (value, length) = leading_f32(text.as_bytes()).expect(text);
        assert_eq!((value.to_bits(), length), (single.to_bits(), text.len()), "{text}");
    }

    #[test]
    fn numbers_are_those_of_the_standard_library() {
        TEXTS.into_iter().for_each(agree);
        for text in ["", "-", ".", "e5", "1e", "1e+", "nan", "inf"] {
            assert_eq!(leading_f64(text.as_bytes()), None, "{text}");
        }
        assert_eq!(leading_f64(b"1x"), Some((1.0, 1)));
    }

    #[test]
    fn short_numbers_of_digits_alone() {
        for (text, found) in [
            ("0", Some((0, 1))),
            ("007 ", Some((7, 3))),
            ("999999999/", Some((999_999_999, 9))),
            ("1234567890", None),
            ("-1", None),
            ("", None),
        ] {
            assert_eq!(leading_digits(text.as_bytes()), found, "{text}");
        }
    }

    /// Numbers halfway between two of single precision, and those just beside them, which double precision cannot tell from them.
    #[test]
    fn no_number_is_rounded_twice() {
        for halfway in [
            "16777217",
            "1.00000005960464477539",
            "33554434",
            "33554438e-3",
            "1.401298464324817e-45",
        ] {
            agree(halfway);
            for beside in ["0000000000001", "5"] {
                let dot = if halfway.contains('.') { "" } else { "." };
                if !halfway.contains('e') {
                    agree(&format!("{halfway}{dot}{beside}"));
                }
            }
        }
    }

    #[test]
    fn random_numbers_are_those_of_the_standard_library() {
        // Marsaglia's generator (2003, "Xorshift RNGs").
        let mut state: u64 = 88_172_645_463_325_252;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state
        };
        for _ in 0..20_000 {
            let digits = next() >> (next() % 64);
            let (point, power) = (next() % 12, next() % 50);
            agree(&format!("{digits}.{point:03}e{}", power as i64 - 25));
            agree(&format!("{:.*}", point as usize, digits as f64 / 1e7));
        }
    }
}
