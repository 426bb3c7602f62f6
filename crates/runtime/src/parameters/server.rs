//! The six parameter services and `/parameter_events`.

use super::Store;
use crate::node::Node;
use crate::qos::Qos;
use crate::topics::Publisher;
use crate::{RuntimeError, convert_time};
use std::future::ready;
use std::sync::Arc;
use tdv_msgs::rcl_interfaces::msg::{
    ListParametersResult, Parameter, ParameterEvent, SetParametersResult,
};
use tdv_msgs::rcl_interfaces::srv::{
    DescribeParameters, DescribeParametersResponse, GetParameterTypes, GetParameterTypesResponse,
    GetParameters, GetParametersResponse, ListParameters, ListParametersResponse, SetParameters,
    SetParametersAtomically, SetParametersAtomicallyResponse, SetParametersResponse,
};

/// Offers the store under the node's name.
///
/// # Errors
/// [`RuntimeError`].
pub(crate) fn serve(node: &Node, store: Store) -> Result<(), RuntimeError> {
    let store = Arc::new(store);
    let events: Arc<Publisher<ParameterEvent>> =
        Arc::new(node.publisher("/parameter_events", Qos::reliable(100))?);
    events.publish(event(node, store.all(), Vec::new()));

    let s = store.clone();
    node.service::<GetParameters, _, _>("~/get_parameters", move |request| {
        ready(GetParametersResponse { values: request.names.iter().map(|n| s.get(n)).collect() })
    })?;
    let s = store.clone();
    node.service::<GetParameterTypes, _, _>("~/get_parameter_types", move |request| {
        let types = request.names.iter().map(|n| s.get(n).r#type).collect();
        ready(GetParameterTypesResponse { types })
    })?;
    let s = store.clone();
    node.service::<DescribeParameters, _, _>("~/describe_parameters", move |request| {
        let descriptors = request.names.iter().map(|n| s.describe(n)).collect();
        ready(DescribeParametersResponse { descriptors })
    })?;
    let s = store.clone();
    node.service::<ListParameters, _, _>("~/list_parameters", move |request| {
        let result = list(&s.names(), &request.prefixes, request.depth);
        ready(ListParametersResponse { result })
    })?;
    let (s, n, e) = (store.clone(), node.clone(), events.clone());
    node.service::<SetParameters, _, _>("~/set_parameters", move |request| {
        let one_by_one =
            request.parameters.iter().map(|p| set(&n, &s, &e, std::slice::from_ref(p)));
        ready(SetParametersResponse { results: one_by_one.collect() })
    })?;
    let (s, n, e) = (store, node.clone(), events);
    node.service::<SetParametersAtomically, _, _>("~/set_parameters_atomically", move |request| {
        ready(SetParametersAtomicallyResponse { result: set(&n, &s, &e, &request.parameters) })
    })
}

fn set(
    node: &Node,
    store: &Store,
    events: &Publisher<ParameterEvent>,
    parameters: &[Parameter],
) -> SetParametersResult {
    match store.set(parameters) {
        Ok(()) => {
            let changed: Vec<Parameter> = parameters
                .iter()
                .map(|p| Parameter { name: p.name.clone(), value: store.get(&p.name) })
                .collect();
            for p in &changed {
                tracing::info!("parameter '{}' set", p.name);
            }
            events.publish(event(node, Vec::new(), changed));
            SetParametersResult { successful: true, reason: String::new() }
        }
        Err(reason) => {
            tracing::warn!("parameter change refused: {reason}");
            SetParametersResult { successful: false, reason }
        }
    }
}

fn event(
    node: &Node,
    new_parameters: Vec<Parameter>,
    changed_parameters: Vec<Parameter>,
) -> ParameterEvent {
    ParameterEvent {
        stamp: convert_time(node.now()),
        node: node.fully_qualified_name(),
        new_parameters,
        changed_parameters,
        deleted_parameters: Vec::new(),
    }
}

/// Names under the prefixes, down to `depth` levels below them (0 = all), and the groups they are in.
fn list(names: &[String], prefixes: &[String], depth: u64) -> ListParametersResult {
    let below = |name: &str, prefix: &str| -> Option<usize> {
        let rest = if prefix.is_empty() {
            name
        } else if name == prefix {
            return Some(0);
        } else {
            name.strip_prefix(prefix)?.strip_prefix('.')?
        };
        Some(rest.matches('.').count() + 1)
    };
    let all = [String::new()];
    let prefixes = if prefixes.is_empty() { &all[..] } else { prefixes };
    let mut out = ListParametersResult::default();
    for name in names {
        let levels = prefixes.iter().filter_map(|p| below(name, p)).min();
        if levels.is_some_and(|l| depth == 0 || l as u64 <= depth) {
            out.names.push(name.clone());
            if let Some((group, _)) = name.rsplit_once('.')
                && !out.prefixes.iter().any(|p| p == group)
            {
                out.prefixes.push(group.to_string());
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn listing() {
        let names: Vec<String> =
            ["a", "b.c", "b.d.e", "bc"].iter().map(|s| s.to_string()).collect();
        let all = list(&names, &[], 0);
        assert_eq!(all.names, names);
        assert_eq!(all.prefixes, ["b", "b.d"]);
        assert_eq!(list(&names, &[], 1).names, ["a", "bc"]);
        assert_eq!(list(&names, &["b".into()], 0).names, ["b.c", "b.d.e"]);
        assert_eq!(list(&names, &["b".into()], 1).names, ["b.c"]);
        assert_eq!(list(&names, &["a".into()], 1).names, ["a"]);
    }
}
