//! Cycles, threads, calls that wait, programs beside each other.

use super::{Notes, load, run_for};
use crate::{Limits, Machine};

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
