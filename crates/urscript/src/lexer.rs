//! Text to tokens.

use crate::error::{ErrorKind, ScriptError};
use std::sync::Arc;

/// A token's content.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Token {
    /// Name or keyword.
    Name(Arc<str>),
    Int(i32),
    Float(f64),
    Text(Arc<str>),
    /// Operator or bracket.
    Sign(&'static str),
    End,
}

/// A token with its place.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    pub token: Token,
    pub line: u32,
    /// First on its line: an opening bracket here begins a new statement.
    pub first: bool,
}

/// Longer signs before their beginnings.
const SIGNS: [&str; 21] = [
    "==", "!=", "<=", ">=", "<", ">", "=", "+", "-", "*", "/", "%", "(", ")", "[", "]", ",", ":",
    ".", ";", "$",
];

/// Splits a script text. The last token is [`Token::End`].
pub(crate) fn tokens(text: &str) -> Result<Vec<Placed>, ScriptError> {
    let bytes = text.as_bytes();
    let mut out = Vec::new();
    let (mut at, mut line, mut first) = (0, 1_u32, true);
    while at < bytes.len() {
        let c = bytes[at];
        let rest = &text[at..];
        match c {
            b'\n' => {
                line += 1;
                first = true;
                at += 1;
            }
            b'\\' if rest[1..].trim_start_matches([' ', '\t', '\r']).starts_with('\n') => {
                at += 1 + rest[1..].find('\n').unwrap_or(0) + 1;
                line += 1;
            }
            c if c.is_ascii_whitespace() || c == 0 => at += 1,
            b'#' => at += rest.find('\n').unwrap_or(rest.len()),
            _ => {
                let (token, used) = next(rest).map_err(|k| k.at(line))?;
                out.push(Placed { token, line, first });
                line += rest[..used].matches('\n').count() as u32;
                first = false;
                at += used;
            }
        }
    }
    out.push(Placed { token: Token::End, line, first: true });
    Ok(out)
}

/// The token at the beginning of `rest` and the bytes that it takes.
fn next(rest: &str) -> Result<(Token, usize), ErrorKind> {
    let bytes = rest.as_bytes();
    let c = bytes[0];
    let digit = |i: usize| bytes.get(i).is_some_and(u8::is_ascii_digit);
    if c.is_ascii_alphabetic() || c == b'_' {
        let used = bytes.iter().take_while(|b| b.is_ascii_alphanumeric() || **b == b'_').count();
        return Ok((Token::Name(rest[..used].into()), used));
    }
    if c.is_ascii_digit() || (c == b'.' && digit(1)) {
        return number(rest);
    }
    if c == b'"' || c == b'\'' {
        return quoted(rest, c);
    }
    match SIGNS.iter().find(|s| rest.starts_with(**s)) {
        Some(sign) => Ok((Token::Sign(sign), sign.len())),
        None => {
            let c = rest.chars().next().unwrap_or(' ');
            Err(ErrorKind::syntax(format!("unexpected character {c:?}")))
        }
    }
}

fn number(rest: &str) -> Result<(Token, usize), ErrorKind> {
    let bytes = rest.as_bytes();
    let bad = |text: &str| ErrorKind::syntax(format!("'{text}' is not a number"));
    if bytes.len() > 2 && bytes[0] == b'0' && (bytes[1] | 32) == b'x' {
        let digits = bytes[2..].iter().take_while(|b| b.is_ascii_hexdigit()).count();
        let text = &rest[2..2 + digits];
        // Hexadecimal numbers name the bits: 0xFFFFFFFF is -1.
        let value = u32::from_str_radix(text, 16).map_err(|_| bad(&rest[..2 + digits]))?;
        return Ok((Token::Int(value as i32), 2 + digits));
    }
    let digits = |from: usize| bytes[from..].iter().take_while(|b| b.is_ascii_digit()).count();
    let mut used = digits(0);
    let mut whole = true;
    if bytes.get(used) == Some(&b'.') {
        whole = false;
        used += 1 + digits(used + 1);
    }
    if bytes.get(used).is_some_and(|b| (b | 32) == b'e') {
        let sign = usize::from(bytes.get(used + 1).is_some_and(|b| matches!(b, b'+' | b'-')));
        let power = digits((used + 1 + sign).min(bytes.len()));
        if power > 0 {
            whole = false;
            used += 1 + sign + power;
        }
    }
    let text = &rest[..used];
    if whole && let Ok(value) = text.parse() {
        return Ok((Token::Int(value), used));
    }
    text.parse().map(|v| (Token::Float(v), used)).map_err(|_| bad(text))
}

fn quoted(rest: &str, quote: u8) -> Result<(Token, usize), ErrorKind> {
    let mut text = String::new();
    let mut chars = rest.char_indices().skip(1).peekable();
    while let Some((at, c)) = chars.next() {
        match c {
            c if c == char::from(quote) => return Ok((Token::Text(text.into()), at + 1)),
            '\n' => break,
            '\\' => {
                let known = match chars.peek() {
                    Some((_, 'n')) => '\n',
                    Some((_, 't')) => '\t',
                    Some((_, 'r')) => '\r',
                    Some((_, c @ ('"' | '\'' | '\\'))) => *c,
                    _ => {
                        text.push('\\');
                        continue;
                    }
                };
                chars.next();
                text.push(known);
            }
            c => text.push(c),
        }
    }
    Err(ErrorKind::syntax("a string has no closing quote on its line"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(text: &str) -> Vec<Token> {
        tokens(text).unwrap().into_iter().map(|p| p.token).collect()
    }

    #[test]
    fn numbers_of_all_forms() {
        use Token::*;
        assert_eq!(
            plain("1 0x1F 0xFFFFFFFF 1.5 .5 2. 1e3 1.2E-2 2147483648"),
            [
                Int(1),
                Int(31),
                Int(-1),
                Float(1.5),
                Float(0.5),
                Float(2.0),
                Float(1e3),
                Float(0.012),
                Float(2_147_483_648.0),
                End
            ]
        );
    }

    #[test]
    fn texts_comments_and_lines() {
        let t = tokens("a # \"no\n\"x\\\"y\\n\" \\\n b").unwrap();
        assert_eq!(t[1].token, Token::Text("x\"y\n".into()));
        assert_eq!((t[1].line, t[1].first), (2, true));
        assert_eq!((t[2].line, t[2].first), (3, false));
    }

    #[test]
    fn errors_name_the_line() {
        assert_eq!(tokens("a\nb = \"x\n").unwrap_err().line, 2);
        assert_eq!(
            tokens("\n\n a ? b").unwrap_err().to_string(),
            "line 3: syntax error: unexpected character '?'"
        );
        assert!(tokens("0xFFFFFFFFF").is_err());
    }
}
