//! Which words of a prompt mean nothing to it, and which name a part of a thing.

/// Words that separate or decorate noun phrases.
const STOP: &str = "a an the this that these those its it my your his her their \
    and then with without in into on onto to from of off over under at by near next beside between \
    upon up down out through behind before after against \
    put place set move bring carry pick take grasp grab lift push pull drop release lay stack find \
    track follow look open close shut insert pour hold give show get fetch turn locate segment point \
    for is are be was please one thing things object objects item top gently slowly carefully upright \
    aside away left right back there here robot gripper hand arm table desk only let go you me i can \
    could should would so stands stand standing lies lying leave center centre middle some both each \
    where what which who whose has have having";

/// What follows "with" and belongs to the thing before it.
const PARTS: &str = "handle handles lid cap label rim edge stripe stripes tip top bottom base body head \
    ear ears nose face belly pin pins prong prongs inside inner outside border side sides front door \
    spout neck knob bar print lettering surface foot feet";

/// Words that tell that what follows describes the thing before.
const JOINING: &str = "with has have having whose";

fn holds(list: &str, word: &str) -> bool {
    list.split_ascii_whitespace().any(|w| w == word)
}

/// Whether a word says nothing about which thing is meant.
pub(super) fn is_stop(word: &str) -> bool {
    holds(STOP, word)
}

/// Whether a word names a part of a thing.
pub(super) fn is_part(word: &str) -> bool {
    holds(PARTS, word)
}

/// Whether a word joins a description to the thing before it.
pub(super) fn joins(word: &str) -> bool {
    holds(JOINING, word)
}
