//! Errors and bounds.

use super::{error, failure, load, notes, run_for};
use crate::{ErrorKind, Limits};

#[test]
fn errors_before_the_run_name_line_and_reason() {
    for (text, message) in [
        ("x = 1\ny = foo(1)", "line 2: name 'foo' is not defined"),
        ("def p():\n x = y\nend", "line 2: name 'y' is not defined"),
        ("note()", "line 1: call of 'note': argument 'a' is missing"),
        ("note(1, 2, 3)", "line 1: call of 'note': at most 2 arguments, 3 given"),
        ("note(1, z = 2)", "line 1: call of 'note': there is no parameter 'z'"),
        ("note(1, a = 2)", "line 1: call of 'note': argument 'a' is given twice"),
        (
            "def p():\n pass\n",
            "line 3: syntax error: 'end' expected for the definition of line 1 before the end of the text",
        ),
        ("x = 1\nend", "line 2: syntax error: 'end' without a block that it belongs to"),
        ("x = )", "line 1: syntax error: an expression expected before ')'"),
        ("1 = x", "line 1: syntax error: only variables and their elements can be changed"),
        ("x = p[1, 2, 3]", "line 1: syntax error: a pose has 6 elements, not 3"),
        ("break", "line 1: syntax error: 'break' outside of a loop"),
        (
            "sec s():\n thread t():\n end\nend",
            "line 2: syntax error: a secondary program has no threads",
        ),
        (
            "def p():\n def f():\n end\n x = run f()\nend",
            "line 4: type error: 'f' is a function; 'run' needs a thread",
        ),
    ] {
        assert_eq!(error(text), message, "{text}");
    }
}

#[test]
fn errors_of_the_run_name_line_and_reason() {
    for (text, message) in [
        ("x = [1]\ny = x[1]", "line 2: value error: index 1 is outside the list of 1 elements"),
        ("x = 1 / 0", "line 1: value error: division by zero"),
        ("x = 1\n\ny = sqrt(-x)", "line 3: value error: sqrt: root of -1"),
        ("fail()", "line 1: fail: it failed"),
        ("def p():\n if False:\n  x = 1\n end\n note(x)\nend", "line 5: name 'x' is not defined"),
    ] {
        assert_eq!(failure(text).to_string(), message, "{text}");
    }
}

#[test]
fn computing_without_end_is_an_error() {
    let (_, ended) =
        run_for("x = 0\nwhile True:\n x = x + 1\nend", Limits::default().overruns as usize);
    assert!(ended.is_empty());
    let e = failure("x = 0\nwhile True:\n x = x + 1\nend");
    assert_eq!(e.kind, ErrorKind::Endless);
    assert!((2..=3).contains(&e.line), "{e}");
    // A long computation that ends is none.
    assert_eq!(notes("i = 0\nwhile i < 30000:\n i = i + 1\nend\nnote(i)"), ["30000"]);
}

#[test]
fn bounds_hold() {
    for text in [
        "def f(x):\n return f(x)\nend\ny = f(1)",
        "x = make_list(100000, 0)",
        "s = \"0123456789abcdef\"\nwhile True:\n s = str_cat(s, s)\nend",
        "l = [1, 2]\nwhile True:\n l = [l, l]\nend",
        "thread t():\n sync()\n sync()\nend\nwhile True:\n h = run t()\nend",
        "m = make_list(60, make_list(60, 0))\nl = make_list(1, 0)\ndef f(a, n):\n b = a + 0\n return f(b, n + 1)\nend\nx = f(m, 0)",
    ] {
        let e = failure(text);
        assert!(matches!(e.kind, ErrorKind::Limit(_)), "{text}: {e}");
    }
    let deep = format!("x = {}1{}", "(".repeat(5000), ")".repeat(5000));
    assert!(matches!(load(&deep).unwrap_err().kind, ErrorKind::Limit(_)));
    let long = format!("x = 1{}", " + 1".repeat(5000));
    assert!(matches!(load(&long).unwrap_err().kind, ErrorKind::Limit(_)));
    assert!(matches!(load(&"if True:\n".repeat(5000)).unwrap_err().kind, ErrorKind::Limit(_)));
    assert!(matches!(load(&"\n".repeat(2 << 20)).unwrap_err().kind, ErrorKind::Limit(_)));
}
