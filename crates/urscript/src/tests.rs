//! Programs run against a host that notes its calls.

use crate::{
    Call, Ended, ErrorKind, Functions, Host, Limits, Machine, Program, Reply, ScriptError, Value,
};

/// What the host of these tests has: `note` writes down, `move` takes `n` cycles, `take` uses up
/// the cycle, `fail` fails.
const FUNCTIONS: &str = "note(a, b = None)\nmove(n, speed = 0.5, name = 'x')\ntake(v)\nfail()\n";

#[derive(Default)]
pub(crate) struct Notes {
    pub notes: Vec<String>,
    pub moves: Vec<(i32, f64)>,
    pub abandoned: Vec<(String, u64)>,
}

impl Host for Notes {
    fn call(&mut self, call: Call<'_>) -> Reply {
        match (call.function, call.args) {
            ("note", [a, Value::Nothing]) => self.notes.push(a.to_string()),
            ("note", [a, b]) => self.notes.push(format!("{a}{b}")),
            ("move", [n, speed, _]) => {
                let n = n.integer().unwrap_or(0);
                if call.waited == 0 {
                    *call.state = Some(Box::new(n));
                    self.moves.push((call.thread, speed.number().unwrap_or(f64::NAN)));
                }
                // The notes of the call must come back unchanged.
                let noted = call.state.as_ref().and_then(|s| s.downcast_ref::<i32>().copied());
                if noted != Some(n) {
                    return Reply::Error("the notes of the call were lost".into());
                }
                if call.waited < n as u64 {
                    return Reply::Wait;
                }
                return Reply::Done(Value::Int(n));
            }
            ("take", [v]) => return Reply::Spent(v.clone()),
            _ => return Reply::Error("it failed".into()),
        }
        Reply::Done(Value::Nothing)
    }
    fn abandoned(&mut self, call: Call<'_>) {
        self.abandoned.push((call.function.into(), call.waited));
    }
}

pub(crate) fn load(text: &str) -> Result<Vec<Program>, ScriptError> {
    Program::load(text, &Functions::parse(FUNCTIONS).unwrap(), &Limits::default())
}

fn error(text: &str) -> String {
    load(text).unwrap_err().to_string()
}

/// Runs a text for at most `cycles`; its notes and its end.
fn run_for(text: &str, cycles: usize) -> (Notes, Vec<Ended>) {
    let mut host = Notes::default();
    let mut machine = Machine::new(0.008, Limits::default(), 7);
    for program in &load(text).unwrap() {
        machine.start(program, &mut host).unwrap();
    }
    let mut ended = Vec::new();
    for _ in 0..cycles {
        ended.extend(machine.cycle(&mut host));
    }
    (host, ended)
}

/// The notes of statements that end without error.
fn notes(text: &str) -> Vec<String> {
    let (host, ended) = run_for(text, 100);
    assert_eq!(ended.iter().map(|e| e.error.clone()).collect::<Vec<_>>(), [None], "{text}");
    host.notes
}

/// The value of an expression as text.
fn eval(expression: &str) -> String {
    notes(&format!("note(to_str({expression}))")).concat()
}

/// The error that ends statements.
fn failure(text: &str) -> ScriptError {
    let (_, ended) = run_for(text, 100);
    ended.into_iter().find_map(|e| e.error).unwrap()
}

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
fn a_program_with_functions_loops_and_named_arguments() {
    let text = "
        def prog():
          def f(a, b = 2, c = b * 10):
            return [a, b, c]
          end
          i = 0
          while True:
            i = i + 1
            if i == 2:
              continue
            elif i > 4: break
            else:
              note(i)
            end
          end
          note(f(1))
          note(f(1, c = 5))
          note(f(c = 3, a = 1, b = f(4, 5, 6)[0]))
          m = [[1, 2], [3, 4]]
          m[0, 1] = 9; m[1][0] = 8
          note(m)
          p = [1, 2]
          p[0] = p[1] * 2
          note(p)
          s = struct(a = [1], b = 2)
          s.a[0] = 5
          s.b = 7
          note(s)
          # An assignment may go on in the next line, and a statement may follow on the same one.
          x = # comment
            1    y = 2
          note(x +
            y)
          $ 3 \"a label\" \"noBreak\"
          halt
          note(\"never\")
        end";
    assert_eq!(
        notes(text),
        [
            "1",
            "3",
            "4",
            "[1, 2, 20]",
            "[1, 2, 5]",
            "[1, 4, 3]",
            "[[1, 9], [8, 4]]",
            "[4, 2]",
            "struct(a = [5], b = 7)",
            "3"
        ]
    );
}

#[test]
fn scopes_follow_the_manual() {
    let text = "
        def prog():
          a = 0
          global b = 0
          def set():
            a = 1        # the first level is global
            local b = 5  # hides the global
            c = 7        # local: no such global
            def inner():
              b = 3      # the global again, not the local of set
            end
            inner()
            return b + c
          end
          note(set())
          note(a, b)
        end";
    assert_eq!(notes(text), ["12", "13"]);
    assert_eq!(
        error("def p():\n def f():\n  c = 1\n end\n f()\n note(c)\nend"),
        "line 6: name 'c' is not defined"
    );
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
fn a_call_may_take_many_cycles() {
    let (host, ended) = run_for("x = move(3, speed = 0.25) + 1\nnote(x)", 3);
    assert!(host.notes.is_empty() && ended.is_empty());
    let (host, ended) = run_for("x = move(3, speed = 0.25) + 1\nnote(x)", 4);
    assert_eq!((host.notes, host.moves, ended.len()), (vec!["4".to_string()], vec![(1, 0.25)], 1));
}

#[test]
fn sync_and_sleep_take_time() {
    let text = "note(1)\nsync()\nnote(2)\nsleep(0.02)\nnote(3)\nx = take(5)\nnote(x)";
    let seen = |n| run_for(text, n).0.notes.join("");
    // 20 ms are 2.5 cycles of 8 ms.
    assert_eq!(
        (1..8).map(seen).collect::<Vec<_>>(),
        ["1", "12", "12", "12", "123", "1235", "1235"]
    );
}

#[test]
fn threads_run_in_turn_and_end_with_the_program() {
    let text = "
        def p():
          thread t():
            while True:
              note(\"t\")
              sync()
            end
          end
          h = run t()
          i = 0
          while i < 3:
            note(\"m\")
            sync()
            i = i + 1
          end
        end";
    let (host, ended) = run_for(text, 10);
    assert_eq!(host.notes.concat(), "mtmtmt");
    assert_eq!(ended.len(), 1);
}

#[test]
fn join_waits_and_kill_tells_the_host() {
    let text = "
        def p():
          thread a():
            n = move(2)
            note(\"a\")
          end
          thread b():
            n = move(50)
            note(\"b\")
          end
          ha = run a()
          hb = run b()
          join ha
          note(\"joined\")
          kill hb
          kill hb
          join hb
          note(\"end\")
        end";
    let (host, _) = run_for(text, 3);
    assert_eq!(host.notes, ["a", "joined", "end"]);
    assert_eq!(host.abandoned, [("move".to_string(), 3)]);
}

#[test]
fn a_critical_section_keeps_others_out() {
    let text = "
        def p():
          thread t():
            while True:
              note(\"t\")
              sync()
            end
          end
          h = run t()
          enter_critical
          note(\"a\")
          sync()
          sync()
          note(\"b\")
          exit_critical
          sync()
        end";
    assert_eq!(run_for(text, 10).0.notes.concat(), "abt");
}

#[test]
fn a_second_program_replaces_and_a_secondary_one_does_not() {
    let mut host = Notes::default();
    let mut machine = Machine::new(0.008, Limits::default(), 7);
    let start = |machine: &mut Machine, host: &mut Notes, text: &str| {
        for program in load(text).unwrap() {
            machine.start(&program, host).unwrap();
        }
    };
    start(&mut machine, &mut host, "def one():\n x = move(100)\nend");
    machine.cycle(&mut host);
    start(&mut machine, &mut host, "sec s():\n note(\"s\")\nend");
    let ended = machine.cycle(&mut host);
    assert_eq!((ended.len(), ended[0].secondary, machine.program()), (1, true, Some("one")));
    start(&mut machine, &mut host, "def two():\n note(\"two\")\n sync()\nend");
    assert_eq!(host.abandoned, [("move".to_string(), 2)]);
    machine.cycle(&mut host);
    assert_eq!((host.notes.concat(), machine.program()), ("stwo".to_string(), Some("two")));
    machine.stop(&mut host);
    assert!(!machine.running() && machine.cycle(&mut host).is_empty());
}

#[test]
fn several_programs_in_one_text() {
    let names: Vec<String> =
        load("def a():\nend\nsec b():\nend\n").unwrap().iter().map(|p| p.name().into()).collect();
    assert_eq!(names, ["a", "b"]);
    // Statements see the functions of their text.
    assert_eq!(notes("def f(x):\n return x + 1\nend\nnote(f(1))"), ["2"]);
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

#[test]
fn random_numbers_follow_the_seed() {
    let text = "note(random())\nnote(random())";
    let first = notes(text);
    assert_eq!(first, notes(text));
    assert_ne!(first[0], first[1]);
}
