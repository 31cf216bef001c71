//! Words, numbers and line ends of text formats.

use std::borrow::Cow;

use super::fault;
use crate::error::{Error, Result};

/// What a byte is to a scanner.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Word,
    Blank,
    End,
    Hash,
}

const KINDS: [Kind; 256] = {
    let mut kinds = [Kind::Word; 256];
    // Programs pad files with zeros, and those of DOS end them with 0x1a.
    kinds[0] = Kind::Blank;
    kinds[0x1a] = Kind::Blank;
    kinds[b' ' as usize] = Kind::Blank;
    kinds[b'\t' as usize] = Kind::Blank;
    kinds[0x0b] = Kind::Blank;
    kinds[0x0c] = Kind::Blank;
    kinds[b'\n' as usize] = Kind::End;
    kinds[b'\r' as usize] = Kind::End;
    kinds[b'#' as usize] = Kind::Hash;
    kinds
};

/// A place in a text. Lines end with `\n`, `\r\n` or `\r`.
#[derive(Clone)]
pub(super) struct Text<'a> {
    data: &'a [u8],
    at: usize,
    /// Whether `#` begins a comment.
    comments: bool,
    /// Whether a backslash before the end of a line takes the next line along.
    continued: bool,
}

impl<'a> Text<'a> {
    /// The beginning of a text.
    pub(super) fn new(data: &'a [u8], comments: bool, continued: bool) -> Self {
        Self { data, at: 0, comments, continued }
    }

    /// Goes to a byte.
    pub(super) fn from(mut self, at: usize) -> Self {
        self.at = at;
        self
    }

    /// The byte that comes next.
    pub(super) fn offset(&self) -> usize {
        self.at
    }

    fn kind(&self, at: usize) -> Kind {
        match self.data.get(at) {
            None => Kind::End,
            Some(&byte) => KINDS[byte as usize],
        }
    }

    /// Where the next line begins if the backslash at `at` is the last of its line but for blanks.
    fn joined(&self, at: usize) -> Option<usize> {
        if !self.continued || self.data[at] != b'\\' {
            return None;
        }
        let mut next = at + 1;
        while self.kind(next) == Kind::Blank {
            next += 1;
        }
        (next < self.data.len() && self.kind(next) == Kind::End).then(|| self.after_end(next))
    }

    /// Where the line after the line end at `at` begins.
    fn after_end(&self, at: usize) -> usize {
        let two = self.data.get(at) == Some(&b'\r') && self.data.get(at + 1) == Some(&b'\n');
        (at + if two { 2 } else { 1 }).min(self.data.len())
    }

    /// Skips blanks of this line.
    fn blanks(&mut self) {
        loop {
            match self.kind(self.at) {
                Kind::Blank => self.at += 1,
                Kind::Word => match self.joined(self.at) {
                    Some(next) => self.at = next,
                    None => return,
                },
                Kind::End | Kind::Hash => return,
            }
        }
    }

    /// Whether nothing but blanks and a comment is left of the line.
    pub(super) fn line_ends(&mut self) -> bool {
        self.blanks();
        match self.kind(self.at) {
            Kind::End => true,
            Kind::Hash => self.comments,
            _ => false,
        }
    }

    /// The next word of the line; empty at its end.
    pub(super) fn word(&mut self) -> &'a [u8] {
        if self.line_ends() {
            return &[];
        }
        let start = self.at;
        loop {
            match self.kind(self.at) {
                Kind::Word if self.data[self.at] != b'\\' || self.joined(self.at).is_none() => self.at += 1,
                Kind::Hash if !self.comments => self.at += 1,
                _ => return &self.data[start..self.at],
            }
        }
    }

    /// The next word of this line or of those below; nothing at the end of the text.
    pub(super) fn word_below(&mut self) -> Option<&'a [u8]> {
        while self.line_ends() {
            if !self.next_line() {
                return None;
            }
        }
        Some(self.word())
    }

    /// What is left of the line, as a name may be: blanks within, and `#` where no blank is before it.
    pub(super) fn rest(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        self.blanks();
        loop {
            match self.kind(self.at) {
                Kind::End => break,
                Kind::Hash
                    if self.comments && out.last().is_some_and(|b| KINDS[*b as usize] == Kind::Blank) =>
                {
                    break;
                }
                _ => {}
            }
            if let Some(next) = self.joined(self.at) {
                self.at = next;
                out.push(b' ');
                continue;
            }
            out.push(self.data[self.at]);
            self.at += 1;
        }
        while out.last().is_some_and(|b| KINDS[*b as usize] == Kind::Blank) {
            out.pop();
        }
        out
    }

    /// Goes to the next line; false at the end of the text.
    pub(super) fn next_line(&mut self) -> bool {
        while self.kind(self.at) != Kind::End {
            // The backslash at the end of a comment is part of it.
            if KINDS[self.data[self.at] as usize] == Kind::Hash && self.comments {
                while self.kind(self.at) != Kind::End {
                    self.at += 1;
                }
                break;
            }
            self.at = self.joined(self.at).unwrap_or(self.at + 1);
        }
        self.at = self.after_end(self.at);
        self.at < self.data.len()
    }

    /// The number of the line that a byte is in, from 1.
    pub(super) fn line(&self, at: usize) -> usize {
        let before = &self.data[..at.min(self.data.len())];
        let feeds = before.iter().filter(|b| **b == b'\n').count();
        let alone = |k: &usize| before[*k] == b'\r' && self.data.get(k + 1) != Some(&b'\n');
        1 + feeds + (0..before.len()).filter(alone).count()
    }

    /// An error at the line of a byte.
    pub(super) fn fault(&self, at: usize, message: impl Into<String>) -> Error {
        fault(format!("line {}", self.line(at)), message)
    }

    /// The next word of the line as a number.
    pub(super) fn number(&mut self, what: &str) -> Result<f64> {
        let word = self.word();
        number(word).ok_or_else(|| self.expected(word, what))
    }

    /// An error about the word that was read last.
    pub(super) fn expected(&self, word: &[u8], what: &str) -> Error {
        let found = if word.is_empty() {
            if self.at >= self.data.len() { "the end of the file" } else { "the end of the line" }.to_owned()
        } else {
            format!("{:?}", short(word))
        };
        self.fault(self.at.saturating_sub(word.len()), format!("expected {what}, found {found}"))
    }
}

/// A word for messages.
pub(super) fn short(word: &[u8]) -> String {
    let mut text = name(&word[..word.len().min(40)]);
    if word.len() > 40 {
        text.push('…');
    }
    text
}

/// A number as C, C++, Fortran and Microsoft's libraries print it.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    let (negative, digits) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, word),
    };
    let (mut mantissa, mut count, mut scale, mut at) = (0u64, 0, 0i32, 0);
    while let Some(digit @ b'0'..=b'9') = digits.get(at) {
        mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit - b'0'));
        (count, at) = (count + 1, at + 1);
    }
    if digits.get(at) == Some(&b'.') {
        at += 1;
        while let Some(digit @ b'0'..=b'9') = digits.get(at) {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit - b'0'));
            (count, at, scale) = (count + 1, at + 1, scale - 1);
        }
    }
    if let (1.., Some(b'e' | b'E')) = (count, digits.get(at)) {
        let (minus, exponent) = match &digits[at + 1..] {
            [b'-', rest @ ..] => (true, rest),
            [b'+', rest @ ..] => (false, rest),
            rest => (false, rest),
        };
        let fine = (1..=4).contains(&exponent.len()) && exponent.iter().all(u8::is_ascii_digit);
        if !fine {
            return slow_number(word);
        }
        let value = exponent.iter().fold(0, |sum, digit| sum * 10 + i32::from(digit - b'0'));
        scale += if minus { -value } else { value };
        at = digits.len();
    }
    // Both the digits and the power of ten are exact: one operation, rounded once.
    if at < digits.len() || !(1..=19).contains(&count) || mantissa > 1 << 53 || !(-22..=22).contains(&scale) {
        return slow_number(word);
    }
    let power = POWERS[scale.unsigned_abs() as usize];
    let value = if scale < 0 { mantissa as f64 / power } else { mantissa as f64 * power };
    Some(if negative { -value } else { value })
}

const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

#[cold]
fn slow_number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    if let Ok(value) = text.parse() {
        return Some(value);
    }
    let lower = text.to_ascii_lowercase();
    let bare = lower.trim_start_matches(['-', '+']);
    if bare.starts_with("nan") || bare.starts_with("1.#") {
        return Some(if bare.contains("#inf") { f64::INFINITY } else { f64::NAN });
    }
    // Fortran's exponents. Words that have none but begin alike are no numbers either way.
    if bare.starts_with(|c: char| c.is_ascii_digit() || c == '.') {
        lower.replacen('d', "e", 1).parse().ok()
    } else {
        None
    }
}

/// A whole number, of digits alone.
pub(super) fn whole(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, word),
    };
    if digits.is_empty() || digits.len() > 18 {
        return None;
    }
    let mut value = 0i64;
    for digit in digits {
        if !digit.is_ascii_digit() {
            return None;
        }
        value = value * 10 + i64::from(digit - b'0');
    }
    Some(if negative { -value } else { value })
}

/// A name out of bytes of unknown encoding: UTF-8 if it can be, otherwise Latin-1.
pub fn name(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|b| char::from(*b)).collect(),
    }
}

/// A text without the mark of its byte order; UTF-16 becomes UTF-8.
pub(super) fn decoded(data: &[u8]) -> Cow<'_, [u8]> {
    let wide = |big: bool| {
        let units = data[2..].chunks_exact(2).map(|c| {
            let pair = [c[0], c[1]];
            if big { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
        });
        let text: String =
            char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
        Cow::Owned(text.into_bytes())
    };
    match data {
        [0xef, 0xbb, 0xbf, rest @ ..] => Cow::Borrowed(rest),
        [0xff, 0xfe, ..] => wide(false),
        [0xfe, 0xff, ..] => wide(true),
        _ => Cow::Borrowed(data),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_standard_library() {
        for text in [
            "0",
            "-0.0",
            "1.",
            ".5",
            "+3.25e-7",
            "123456789.123456789",
            "1e308",
            "1E+00",
            "9007199254740993",
            "5412345.678000",
            "0.1e-22",
            "1e-400",
            "18446744073709551616",
            "00000000000000000000012",
        ] {
            let expected: f64 = text.parse().unwrap();
            assert_eq!(number(text.as_bytes()).unwrap().to_bits(), expected.to_bits(), "{text}");
        }
        assert_eq!(number(b"1.5D+02"), Some(150.0));
        for text in ["nan", "-nan", "-nan(ind)", "1.#QNAN", "-1.#IND"] {
            assert!(number(text.as_bytes()).unwrap().is_nan(), "{text}");
        }
        for text in ["", "-", ".", "e5", "1,0", "1e", "0x10", "abc", "1.2.3", "d", "--1"] {
            assert_eq!(number(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn lines_end_as_systems_end_them() {
        let mut text = Text::new(b"a b\r\nc\rd # e\\\n f \\ \n g#h\n", true, true);
        assert_eq!((text.word(), text.word(), text.word()), (&b"a"[..], &b"b"[..], &b""[..]));
        assert!(text.next_line());
        assert_eq!(text.word(), b"c");
        assert!(text.next_line());
        assert_eq!((text.word(), text.word()), (&b"d"[..], &b""[..]));
        assert!(text.next_line());
        assert_eq!((text.word(), text.word(), text.word()), (&b"f"[..], &b"g"[..], &b""[..]));
        assert_eq!(text.line(text.offset()), 5);
        assert!(!text.next_line());
        assert_eq!(Text::new(b"  a#b c  # d\n", true, true).rest(), b"a#b c");
    }

    #[test]
    fn utf16_is_read_as_text() {
        let wide: Vec<u8> =
            [0xff, 0xfe].into_iter().chain("vü".encode_utf16().flat_map(u16::to_le_bytes)).collect();
        assert_eq!(&*decoded(&wide), "vü".as_bytes());
        assert_eq!(name(b"gr\xfcn"), "grün");
    }
}
