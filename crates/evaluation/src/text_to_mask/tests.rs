use super::*;
use std::path::Path;
use tdv_perception::Catalogue;

fn models() -> Vec<ObjectModel> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/objects");
    Catalogue::load(&folder).unwrap().models
}

#[test]
fn the_same_seed_asks_the_same_and_a_third_is_absent() {
    let models = models();
    let ask = |seed| -> Vec<Question> {
        (0..9).flat_map(|i| questions(&draw(&models, i, seed), &models, i, seed)).collect()
    };
    let (a, b, c) = (ask(1), ask(1), ask(2));
    assert_eq!(a, b);
    assert_ne!(a, c);
    assert!(a.len() >= 25, "{}", a.len());
    let absent = a.iter().filter(|q| q.target.is_none()).count();
    assert_eq!(absent, 9);
}

#[test]
fn what_is_asked_for_is_seen_and_what_is_absent_is_not_there() {
    let models = models();
    for index in 0..6 {
        let table = draw(&models, index, 4);
        assert!((1..=6).contains(&table.things.len()), "{}", table.things.len());
        for q in questions(&table, &models, index, 4) {
            match q.target {
                Some(i) => assert!(table.things[i].seen, "{q:?}"),
                // An absent thing may only share its name with what is there if a colour is wrong.
                None if q.asked == Asked::Name => {
                    let named = table.things.iter().any(|t| {
                        let name = models[t.model].name.replace('_', " ");
                        q.text.split([' ', '?', ',']).any(|w| w == name)
                    });
                    assert!(!named, "{q:?}");
                }
                None => {}
            }
        }
    }
}

#[test]
fn overlap_counts_pixels_on_both_sides() {
    let mask = Mask { x0: 1, y0: 0, width: 2, height: 2, data: vec![true; 4] };
    // A 4 x 2 picture whose left half is the truth.
    let truth = [true, true, false, false, true, true, false, false];
    assert!((overlap(&mask, &truth, 4) - 2.0 / 6.0).abs() < 1e-12);
}

#[test]
fn a_refusal_where_something_is_counts_as_no_overlap() {
    let answer = |target: Option<&str>, iou, right| Answer {
        scene: 0,
        asked: Asked::Name,
        text: "the mug".into(),
        target: target.map(str::to_owned),
        given: None,
        reason: String::new(),
        iou,
        right,
        ms: 1.0,
    };
    let report = TextMaskReport::new(vec![
        answer(Some("mug"), Some(1.0), true),
        answer(Some("mug"), Some(0.0), false),
        answer(None, None, true),
    ]);
    assert_eq!(report.all.mean_iou, Some(0.5));
    assert!((report.all.right_percent() - 200.0 / 3.0).abs() < 1e-9 && !report.met());
}

#[test]
fn a_picture_is_asked_and_judged() {
    let models = models();
    let mut looks = 0;
    let answers = run(&models, 1, 1, &TextMaskConfig::default(), |look| {
        looks += 1;
        assert_eq!(look.truth.is_empty(), look.answer.target.is_none());
    })
    .unwrap();
    assert_eq!((answers.len(), looks), (3, 3));
    assert!(answers.iter().any(|a| a.right), "{answers:#?}");
}
