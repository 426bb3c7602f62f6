//! Which names are global, local, or functions ("Scoping rules" of the script manual): everything
//! assigned on the first level of a program is global; elsewhere a name without qualifier is the
//! global of that name if there is one, and else local.

use crate::syntax::{Function, Name, Qualifier, Statement, StatementKind};
use std::collections::{HashMap, HashSet};

/// Calls `visit` for each statement of a body, nested blocks included, nested functions not.
fn walk<'a>(body: &'a [Statement], visit: &mut impl FnMut(&'a Statement)) {
    for statement in body {
        visit(statement);
        match &statement.kind {
            StatementKind::If { branches, otherwise } => {
                for (_, block) in branches {
                    walk(block, visit);
                }
                walk(otherwise, visit);
            }
            StatementKind::While { body, .. } => walk(body, visit),
            _ => {}
        }
    }
}

/// The functions that a body defines itself.
pub(super) fn definitions(body: &[Statement]) -> Vec<&Function> {
    let mut found = Vec::new();
    walk(body, &mut |s| {
        if let StatementKind::Define(f) = &s.kind {
            found.push(f);
        }
    });
    found
}

/// The variable that a statement names, with its qualifier.
fn variable(statement: &Statement) -> Option<(Qualifier, &Name)> {
    match &statement.kind {
        StatementKind::Assign { qualifier, name, .. }
        | StatementKind::Declare { qualifier, name } => Some((*qualifier, name)),
        _ => None,
    }
}

/// All globals of a program with this body, numbered in the order of the text.
pub(super) fn globals(body: &[Statement]) -> Vec<Name> {
    let mut names = Vec::new();
    let mut seen = HashSet::new();
    collect(body, true, &mut |name| {
        if seen.insert(name.clone()) {
            names.push(name.clone());
        }
    });
    names
}

fn collect(body: &[Statement], first_level: bool, found: &mut impl FnMut(&Name)) {
    walk(body, &mut |s| {
        if let Some((qualifier, name)) = variable(s)
            && (first_level || qualifier == Qualifier::Global)
        {
            found(name);
        }
    });
    for function in definitions(body) {
        collect(&function.body, false, found);
    }
}

/// The locals of a function: parameters first.
pub(super) fn locals(function: &Function, globals: &HashMap<Name, usize>) -> Vec<Name> {
    let mut names: Vec<Name> = function.parameters.iter().map(|(n, _)| n.clone()).collect();
    let mut seen: HashSet<Name> = names.iter().cloned().collect();
    let mut declared_global = HashSet::new();
    walk(&function.body, &mut |s| {
        if let Some((Qualifier::Global, name)) = variable(s) {
            declared_global.insert(name.clone());
        }
    });
    let mut add = |name: &Name| {
        if seen.insert(name.clone()) {
            names.push(name.clone());
        }
    };
    walk(&function.body, &mut |s| match variable(s) {
        Some((Qualifier::Local, name)) if !declared_global.contains(name) => add(name),
        Some((Qualifier::Free, name)) if !globals.contains_key(name) => add(name),
        _ => {}
    });
    names
}
