//! No text whatever may panic, hang or fill the memory. `TDV_URSCRIPT_CASES` sets the number of
//! cases of each test.

use crate::{CONTROLLER, Call, Functions, Host, Limits, Machine, Program, Reply, Value};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;

/// Texts to change: together they use every part of the language.
const SEEDS: [&str; 5] = [
    "def prog():\n  global a = [1, 2.5, -3]\n  def f(x, y = 2):\n    local z = x * y\n    if z > 4 and not x == 1:\n      return z\n    elif z < 0 or x != y: return -z\n    else:\n      a[1] = z / 3 % 2\n    end\n    return f(x + 1, y = y)\n  end\n  b = f(1)\n  while b < 30:\n    b = b + f(2)\n    if b > 20:\n      break\n    end\n    continue\n  end\nend\n",
    "def prog():\n  n = 0\n  thread t():\n    while True:\n      enter_critical\n      n = n + 1\n      exit_critical\n      sync()\n    end\n  end\n  h = run t()\n  g = run t()\n  sleep(0.05)\n  kill h\n  movej([0, 1, 2, 3, 4, 5], a = 2, t = 1)\n  join g\nend\n",
    "p = p[1, 2, 3, 0.1, 0.2, 0.3]\np[0] = norm(pose_trans(p, pose_inv(p)))\nm = [[1, 2], [3, 4]]\nm[0, 1] = m[1][0]\nm = inv(m) * transpose(m) + m\ns = struct(a = [1, [2, 3]], b = \"x\\n\")\ns.a[1][0] = length(s.a)\nl = make_list(1, 0, 50)\nl.append(2)\nl.extend(l)\nl.insert(1, 3)\nl.remove(0)\ns.a[1].pop()\ntextmsg(str_cat(s, to_str(m)), m.shape())\n",
    "sec s():\n  set_standard_digital_out(0, True)\n  x = binary_list_to_integer(integer_to_binary_list(0xFF))\n  $ 3 \"label\" \"noBreak\"\n  halt\nend\ndef main():\n  i = 0\n  l = make_list(10, [0, 1])\n  while i < 10:\n    l[i] = [i, str_sub(\"hello\", i / 2)]; i = i + 1\n  end\nend",
    "def prog():\n  q = get_actual_joint_positions()\n  while True:\n    q[0] = q[0] + 0.001 * sin(random())\n    servoj(q, t = 0.008, lookahead_time = 0.1, gain = 300)\n    l = [q, q]\n    l = [l, l]\n    s = to_str(l)\n  end\nend\n",
];

const WORDS: [&str; 76] = [
    "def",
    "end",
    "thread",
    "sec",
    "if",
    "elif",
    "else",
    "while",
    "return",
    "break",
    "continue",
    "global",
    "local",
    "run",
    "kill",
    "join",
    "enter_critical",
    "exit_critical",
    "halt",
    "and",
    "or",
    "not",
    "xor",
    "True",
    "False",
    "p",
    "f",
    "x",
    "y",
    "t",
    "prog",
    "()",
    ":",
    "\n",
    "\n",
    "\n",
    "(",
    ")",
    "[",
    "]",
    ",",
    ".",
    "=",
    "==",
    "<",
    "+",
    "-",
    "*",
    "/",
    "%",
    "0",
    "1",
    "2.5",
    "1e308",
    "2147483647",
    "\"a\"",
    "struct(",
    "make_list(",
    "str_cat(",
    "to_str(",
    "inv(",
    "length(",
    "movej(",
    "sleep(",
    "sync()",
    "while True:\n",
    "x = [x, x]\n",
    "x = 1\n",
    "end\n",
    "f(x)",
    "x.append(x)\n",
    "x.extend(x)\n",
    ".slice(0, 1)",
    "make_list(1, 0, 99)",
    "x[0]",
    "$ 1 \"a\"",
];

/// A host that answers anything and lets some calls wait.
struct Anything;

impl Host for Anything {
    fn call(&mut self, call: Call<'_>) -> Reply {
        match call.function {
            "movej" if call.waited < 3 => Reply::Wait,
            "servoj" if call.waited < 1 => Reply::Wait,
            "get_actual_joint_positions" => Reply::Done(Value::numbers(&[0.5; 6])),
            "popup" => Reply::Error("no".into()),
            name if name.starts_with("get_") => Reply::Spent(Value::Float(1.0)),
            _ => Reply::Done(Value::Nothing),
        }
    }
}

/// Loads and runs a text under tight bounds; asserts that they hold.
fn run(text: &str) {
    let limits = Limits {
        source: 1 << 16,
        threads: 8,
        frames: 20,
        value: 200,
        memory: 2000,
        instructions: 500,
        overruns: 3,
        secondary: 2,
    };
    let Ok(functions) = Functions::parse(CONTROLLER) else { return };
    let Ok(programs) = Program::load(text, &functions, &limits) else { return };
    let mut machine = Machine::new(0.008, limits.clone(), 1);
    for program in &programs {
        let _ = machine.start(program, &mut Anything);
    }
    for _ in 0..12 {
        machine.cycle(&mut Anything);
        assert!(machine.threads() <= limits.threads * (1 + limits.secondary), "{text}");
        // Constants of the text may lie on the stack besides what was made.
        let bound = (limits.memory * 5 / 4 + limits.value) * (1 + limits.secondary) + text.len();
        assert!(machine.elements() <= bound, "{} elements: {text}", machine.elements());
    }
    machine.stop(&mut Anything);
}

fn cases() -> ProptestConfig {
    let cases =
        std::env::var("TDV_URSCRIPT_CASES").ok().and_then(|c| c.parse().ok()).unwrap_or(400);
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

/// One change of a text at a place (both as shares of its length) with a word.
fn change(text: &str, kind: u8, at: usize, len: usize, word: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    if chars.is_empty() {
        return word.into();
    }
    let at = at % chars.len();
    let to = (at + len % 20).min(chars.len());
    let (head, cut, tail) = (&chars[..at], &chars[at..to], &chars[to..]);
    let cut: Vec<char> = match kind % 5 {
        0 => Vec::new(),
        1 => [cut, cut].concat(),
        2 => word.chars().collect(),
        3 => cut.iter().rev().copied().collect(),
        _ => cut.iter().copied().chain(word.chars()).collect(),
    };
    head.iter().chain(&cut).chain(tail).collect()
}

/// A seed with some changes.
fn changed() -> impl Strategy<Value = String> {
    let word = prop::sample::select(&WORDS[..]);
    let changes = prop::collection::vec((any::<u8>(), any::<usize>(), any::<usize>(), word), 1..6);
    (0..SEEDS.len(), changes).prop_map(|(seed, changes)| {
        changes.iter().fold(SEEDS[seed].to_string(), |t, (kind, at, len, word)| {
            change(&t, *kind, *at, *len, word)
        })
    })
}

/// Expressions and statements that may stand anywhere in a program.
const EXPRESSIONS: [&str; 22] = [
    "0",
    "-1",
    "2147483647",
    "1e308",
    "0.5",
    "True",
    "\"text\"",
    "[1, 2, 3]",
    "[[1, 2], [3, 4]]",
    "[]",
    "p[0, 0, 0, 0, 0, 3]",
    "random()",
    "struct(a = 1)",
    "make_list(3, 0, 9)",
    "make_list(99, [1, 2])",
    "to_str([1, 2])",
    "get_actual_joint_positions()",
    "(1 - 1)",
    "not True",
    "inv([[1, 2], [3, 4]])",
    "integer_to_binary_list(5)",
    "zz",
];
const STATEMENTS: [&str; 20] = [
    "sync()",
    "sleep(0.01)",
    "zz = 1",
    "zz = [1, 2]",
    "zz = [zz, zz]",
    "zz = zz + zz",
    "zz = zz * zz",
    "zz[0] = zz",
    "zz = str_cat(zz, zz)",
    "zz = make_list(2, zz, 50)",
    "zz.append(zz)",
    "zz.extend(zz)",
    "while True:\n zz = [1, [zz]]\nend",
    "while random() < 0.9:\n zz = random()\nend",
    "halt",
    "return zz",
    "enter_critical",
    "exit_critical",
    "movej(zz)",
    "if random() < 0.5:\n kill 2\nelse:\n join 1\nend",
];

/// A seed with statements inserted and numbers exchanged, so that most of the results load.
fn edited() -> impl Strategy<Value = String> {
    let edit = (any::<bool>(), any::<usize>(), 0..EXPRESSIONS.len(), 0..STATEMENTS.len());
    (0..SEEDS.len(), prop::collection::vec(edit, 1..8)).prop_map(|(seed, edits)| {
        let mut lines: Vec<String> = SEEDS[seed].lines().map(Into::into).collect();
        for (insert, place, expression, statement) in edits {
            // Behind the first line, which opens the program.
            let at = 1 + place % (lines.len() - 1);
            let digit = lines[at].find(|c: char| c.is_ascii_digit());
            match digit {
                Some(digit) if !insert => {
                    lines[at]
                        .replace_range(digit..=digit, &format!(" {} ", EXPRESSIONS[expression]));
                }
                _ => lines.insert(at, STATEMENTS[statement].into()),
            }
        }
        // Makes `zz` a variable of every program, and one that may hold anything at first.
        lines.insert(1, "zz = None".into());
        lines.join("\n")
    })
}

/// Texts that are refused at once would test nothing of the machine.
#[test]
fn most_edited_programs_load() {
    let mut runner = TestRunner::deterministic();
    let functions = Functions::parse(CONTROLLER).unwrap();
    let loaded = (0..500)
        .filter(|_| {
            let text = edited().new_tree(&mut runner).unwrap().current();
            Program::load(&text, &functions, &Limits::default()).is_ok()
        })
        .count();
    assert!(loaded > 250, "{loaded} of 500");
}

#[test]
fn the_seeds_load() {
    let functions = Functions::parse(CONTROLLER).unwrap();
    for text in SEEDS {
        assert!(!Program::load(text, &functions, &Limits::default()).unwrap().is_empty());
        run(text);
    }
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        run(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn any_words(words in prop::collection::vec(prop::sample::select(&WORDS[..]), 0..60)) {
        run(&words.join(" "));
    }

    #[test]
    fn changed_programs(text in changed()) {
        run(&text);
    }

    #[test]
    fn edited_programs(text in edited()) {
        run(&text);
    }
}
