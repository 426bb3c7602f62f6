//! Bounds on what a script may use, so that no text whatever can stop the controller.

/// Bounds on one script. The defaults are generous for real programs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one script text.
    pub source: usize,
    /// Threads at one time, the main one included.
    pub threads: usize,
    /// Calls inside calls of one thread.
    pub frames: usize,
    /// Size of one value: elements of a list with all its sublists; 16 bytes of text count as one.
    pub value: usize,
    /// Sum of the sizes of all values that a program holds.
    pub memory: usize,
    /// Instructions of one thread in one cycle (costly ones count more than once).
    pub instructions: u64,
    /// Cycles in a row that a thread may compute through without waiting for the next one.
    pub overruns: u32,
    /// Secondary programs at one time.
    pub secondary: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            source: 1 << 20,
            threads: 32,
            frames: 100,
            value: 4096,
            memory: 1 << 18,
            instructions: 20_000,
            overruns: 50,
            secondary: 8,
        }
    }
}

/// Nesting of blocks and of expressions in a text.
pub(crate) const NESTING: usize = 48;
/// Height of an expression tree: `1 + 1 + ...` is one level per term.
pub(crate) const EXPRESSION_HEIGHT: usize = 400;
/// Lists inside lists.
pub(crate) const LIST_DEPTH: usize = 6;
/// Local variables of one function, arguments of one call.
pub(crate) const LOCALS: usize = 250;
/// Elements of a list that stands in the text.
pub(crate) const LITERAL: usize = 4096;
/// Intermediate values of one thread when it calls a function.
pub(crate) const STACK: usize = 10_000;
