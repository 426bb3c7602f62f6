//! Values, operators, built-in functions.

use super::{error, eval, failure, load, notes};
use crate::{ErrorKind, Limits, Machine, Value};

#[test]
fn precedence_and_number_types() {
    for (text, value) in [
        ("1 + 2 * 3", "7"),
        ("(1 + 2) * 3", "9"),
        ("2 - 3 - 4", "-5"),
        ("-2 * -3", "6"),
        ("7 % 4 * 2", "6"),
        ("1 / 2", "0.5"),
        ("6 / 3", "2"),
        ("0x10 + 1", "17"),
        ("not False and True", "True"),
        ("not (True and False)", "True"),
        ("True or False and False", "True"),
        ("True xor True or True", "True"),
        ("not 1 == 2", "True"),
        ("1 < 2 and 2 >= 2", "True"),
        ("1 == 1.0", "True"),
        ("[1, 2] == [1, 2.0]", "True"),
        ("[1, 2] != [1, 3]", "True"),
        ("\"a\" == \"a\"", "True"),
        ("[[1, 2], [3, 4]][1, 0]", "3"),
        ("[[1, 2], [3, 4]][1][1]", "4"),
        ("[1, 2] + [3, 4]", "[4, 6]"),
        ("2 * [1, 2.5]", "[2, 5]"),
        ("[[1, 2], [3, 4]] * [[0, 1], [1, 0]]", "[[2, 1], [4, 3]]"),
        ("[[1, 2], [3, 4]] * [1, 1]", "[3, 7]"),
        ("p[1, 2, 3, 0, 0, 0.5]", "p[1, 2, 3, 0, 0, 0.5]"),
        ("p[1, 2, 3, 0, 0, 0.5][5]", "0.5"),
        ("1e-7", "1e-07"),
        ("1234567.0", "1.23457e+06"),
        ("0.1 + 0.2", "0.3"),
        ("struct(a = 1, b = [2]).b[0]", "2"),
    ] {
        assert_eq!(eval(text), value, "{text}");
    }
}

#[test]
fn logic_stops_at_the_first_answer() {
    assert_eq!(eval("False and 1 / 0 == 1"), "False");
    assert_eq!(eval("True or 1 / 0 == 1"), "True");
    assert!(matches!(failure("x = True and 1").kind, ErrorKind::Type(_)));
}

#[test]
fn built_ins() {
    for (text, value) in [
        ("norm([3, 4])", "5"),
        ("norm(p[-.2, .2, -.2, -1.57, 0, 3.14])", "3.52768"),
        ("floor(-1.5)", "-2"),
        ("ceil(1.2)", "2"),
        ("atan2(1, 1) * 4", "3.14159"),
        ("log(10, 1000)", "3"),
        ("pow(2, 10)", "1024"),
        ("d2r(180)", "3.14159"),
        ("length([1, 2, 3])", "3"),
        ("size([[1, 2, 3], [4, 5, 6]])", "[2, 3]"),
        ("make_list(3, 0)", "[0, 0, 0]"),
        ("binary_list_to_integer([True, False, True])", "5"),
        ("binary_list_to_integer(integer_to_binary_list(-7))", "-7"),
        ("transpose([[1, 2, 3], [4, 5, 6]])", "[[1, 4], [2, 5], [3, 6]]"),
        ("inv([[2, 0], [0, 4]])", "[[0.5, 0], [0, 0.25]]"),
        ("str_cat(\"a\", 1.50)", "a1.5"),
        ("str_sub(\"hello\", 1, 3)", "ell"),
        ("str_find(\"hello\", \"l\")", "2"),
        ("str_find(\"hello\", \"l\", 3)", "3"),
        ("str_find(\"hello\", \"x\")", "-1"),
        ("str_at(\"h\u{e9}llo\", 1)", "\u{e9}"),
        ("str_len(\"h\u{e9}llo\")", "5"),
        ("str_empty(\"\")", "True"),
        ("to_num(\" 12 \") + to_num(\"0.5\")", "12.5"),
        ("pose_trans(p[1, 0, 0, 0, 0, d2r(90)], p[1, 0, 0, 0, 0, 0])[1]", "1"),
        ("point_dist(p[0, 0, 0, 1, 0, 0], p[0, 3, 4, 0, 0, 0])", "5"),
        (
            "interpolate_pose(p[0, 0, 0, 0, 0, 0], p[1, 0, 0, 0, 0, 1], 0.25)",
            "p[0.25, 0, 0, 0, 0, 0.25]",
        ),
        ("rpy2rotvec([0.5, 0, 0])", "[0.5, 0, 0]"),
    ] {
        assert_eq!(eval(text), value, "{text}");
    }
}

/// Arguments and results of the examples of the script manual, "Module urmath".
#[test]
fn examples_of_the_manual() {
    for (text, value) in [
        ("norm(-5.3)", "5.3"),
        ("normalize([0, 5, 0])", "[0, 1, 0]"),
        ("binary_list_to_integer([True, False, False, True])", "9"),
        ("log(10., 4.)", "0.60206"),
        ("size([[1, 2], [3, 4], [5, 6]])", "[3, 2]"),
        ("transpose([1, 2, 3])", "[[1], [2], [3]]"),
        ("transpose([[1], [2], [3]])", "[1, 2, 3]"),
        ("inv([[0, 1, 0], [0, 0, 1], [1, 0, 0]])", "[[0, 0, 1], [1, 0, 0], [0, 1, 0]]"),
        (
            "interpolate_pose(p[.2, .2, .4, 0, 0, 0], p[.2, .2, .6, 0, 0, 0], .5)",
            "p[0.2, 0.2, 0.5, 0, 0, 0]",
        ),
        (
            "pose_add(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])",
            "p[0.4, 1, 0.7, 3.14, 0, 0]",
        ),
        (
            "pose_sub(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])",
            "p[0, 0, -0.5, 0, 0, 0]",
        ),
        ("121 % [[10, 20], [30, 40]]", "[[1, 1], [1, 1]]"),
        ("[10, 20, 30] / [1, 2, 3]", "[10, 10, 10]"),
        ("struct(a = 1, b = 7)[1]", "7"),
    ] {
        assert_eq!(eval(text), value, "{text}");
    }
    for (text, wanted) in [
        (
            "pose_inv(p[.2, .5, .1, 1.57, 0, 3.14])",
            vec![0.19324, 0.41794, -0.29662, 1.23993, 0.0, 2.47985],
        ),
        (
            "pose_trans(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])",
            vec![0.4, -0.0996, 0.60048, 2.0 * 1.57, 0.0, 0.0],
        ),
        ("rotvec2rpy([3.14, 1.57, 0])", vec![-2.80856, -0.16202, 0.9]),
        ("rpy2rotvec([3.14, 1.57, 0])", vec![2.22153, 0.00177, -2.21976]),
    ] {
        let text = format!("x = {text}\nsync()");
        let mut machine = Machine::new(0.008, Limits::default(), 7);
        machine.start(&load(&text).unwrap()[0], &mut ()).unwrap();
        machine.cycle(&mut ());
        let is = machine.global("x").and_then(Value::vector).unwrap();
        assert_eq!(is.len(), wanted.len());
        // The manual rounds to five places, and its half turns to two.
        assert!(is.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 2e-3), "{text}: {is:?}");
    }
}

#[test]
fn lists_keep_their_capacity() {
    let text = "
        l = make_list(2, 0, capacity = 4)
        l.append(7)
        l.insert(0, 5)
        note(l, l.excess_capacity())
        l.remove(1)
        l.pop()
        note(l, l.capacity())
        l.extend([1, 2])
        note(l.slice(1, 3), l.length())
        s = struct(m = make_list(0, 0, 3))
        s.m.append(4)
        note(s.m.to_string())
        l.clear()
        m = [[1, 2], [3, 4], [5, 6]]
        note(m.get_column(1), m.shape())
        l = [9]
        note(l, l.capacity())";
    assert_eq!(
        notes(text),
        ["[5, 0, 0, 7]0", "[5, 0]4", "[0, 1]4", "[4]", "[2, 4, 6][3, 2]", "[9]4"]
    );
    assert_eq!(
        failure("a = [1, 2]\na = [1, 2, 3]").to_string(),
        "line 2: value error: a list of 3 elements where 2 have room"
    );
    assert!(matches!(failure("a = [1, 2]\na.append(3)").kind, ErrorKind::Value(_)));
    assert!(matches!(failure("a = make_list(1, 0, 5)\na.append(\"x\")").kind, ErrorKind::Type(_)));
    assert_eq!(error("a = [1]\na.push(3)"), "line 2: name '.push' is not defined");
    assert_eq!(
        error("[1].append(3)"),
        "line 1: syntax error: only variables and their elements can be changed"
    );
}

#[test]
fn poses_invert_and_add_up() {
    let text = "
        a = p[1, 2, 3, 0.3, 0.1, -0.2]
        b = p[0.1, 0, 1, 0, 0.5, 0.7]
        one = pose_trans(a, pose_inv(a))
        note(norm(one) + pose_dist(one, p[0, 0, 0, 0, 0, 0]) < 0.000000001)
        note(pose_dist(pose_add(pose_sub(a, b), b), a) < 0.000000001)
        back = rpy2rotvec(rotvec2rpy([0.3, 0.1, -0.2]))
        note(norm(back - [0.3, 0.1, -0.2]) < 0.000000001)
        # A force at a lever arm of 1 m along x.
        note(wrench_trans(p[1, 0, 0, 0, 0, 0], [0, 2, 0, 0, 0, 0]))";
    assert_eq!(notes(text), ["True", "True", "True", "[0, 2, 0, 0, 0, -2]"]);
}

#[test]
fn lists_are_values() {
    assert_eq!(notes("a = [1, 2]\nb = a\nb[0] = 9\nnote(a)\nnote(b)"), ["[1, 2]", "[9, 2]"]);
}

#[test]
fn types_of_variables_stay() {
    assert_eq!(notes("a = 1\na = 2.5\nnote(a)"), ["2.5"]);
    let e = failure("a = 1\na = \"x\"");
    assert_eq!(
        e.to_string(),
        "line 2: type error: the variable 'a' is of type int and cannot become string"
    );
    assert!(matches!(failure("if 1:\n pass\nend").kind, ErrorKind::Type(_)));
}

#[test]
fn random_numbers_follow_the_seed() {
    let text = "note(random())\nnote(random())";
    let first = notes(text);
    assert_eq!(first, notes(text));
    assert_ne!(first[0], first[1]);
}
