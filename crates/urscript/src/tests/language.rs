//! Programs, functions, scopes.

use super::{error, load, notes};

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
fn several_programs_in_one_text() {
    let names: Vec<String> =
        load("def a():\nend\nsec b():\nend\n").unwrap().iter().map(|p| p.name().into()).collect();
    assert_eq!(names, ["a", "b"]);
    // Statements see the functions of their text.
    assert_eq!(notes("def f(x):\n return x + 1\nend\nnote(f(1))"), ["2"]);
}
