//! Live values behind the parameter services.

use super::tree::{flatten, from_ros, merge, nested, to_ros};
use super::{Parameters, Params};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};
use tdv_msgs::rcl_interfaces::msg::{Parameter, ParameterDescriptor, ParameterValue};
use tokio::sync::watch;

/// Checks a whole tree and hands it to the node.
type Apply = dyn Fn(Value) -> Result<(), String> + Send + Sync;

/// Values, rules and the way to the node, without the node's own type.
pub(crate) struct Store {
    tree: Mutex<Value>,
    /// The defaults' tree: its leaves give the types.
    types: Value,
    apply: Box<Apply>,
    live: &'static [&'static str],
    describe: fn(&str) -> &'static str,
    /// Parameters of the runtime itself, read-only.
    fixed: BTreeMap<String, (Value, &'static str)>,
}

impl Store {
    /// The store and the node's view of it. `use_sim_time` is the runtime's own parameter.
    pub fn new<P: Parameters>(values: P, use_sim_time: bool) -> (Self, Params<P>) {
        let tree = serde_json::to_value(&values).unwrap_or_default();
        let types = serde_json::to_value(P::default()).unwrap_or_default();
        let (sender, receiver) = watch::channel(Arc::new(values));
        let apply = move |tree: Value| {
            let values: P = serde_json::from_value(tree).map_err(|e| e.to_string())?;
            let problems = values.validate();
            if !problems.is_empty() {
                return Err(problems.join("; "));
            }
            sender.send_replace(Arc::new(values));
            Ok(())
        };
        let mut fixed = BTreeMap::new();
        if tree.get("use_sim_time").is_none() {
            let text = "time comes from /clock instead of the system";
            fixed.insert("use_sim_time".to_string(), (Value::Bool(use_sim_time), text));
        }
        let store = Self {
            tree: Mutex::new(tree),
            types,
            apply: Box::new(apply),
            live: P::live(),
            describe: P::describe,
            fixed,
        };
        (store, Params::new(receiver))
    }

    fn tree(&self) -> MutexGuard<'_, Value> {
        // A panic while the lock was held cannot leave a half-written tree: it is replaced whole.
        self.tree.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    fn is_live(&self, name: &str) -> bool {
        self.live.iter().any(|live| {
            name == *live || name.strip_prefix(live).is_some_and(|rest| rest.starts_with('.'))
        })
    }

    /// All names in order.
    pub fn names(&self) -> Vec<String> {
        let tree = self.tree();
        let own = flatten(&tree).into_iter().map(|(name, _)| name);
        let mut names: Vec<String> = self.fixed.keys().cloned().chain(own).collect();
        names.sort();
        names
    }

    /// One value; not set when there is no such parameter.
    pub fn get(&self, name: &str) -> ParameterValue {
        if let Some((value, _)) = self.fixed.get(name) {
            return to_ros(value);
        }
        let tree = self.tree();
        flatten(&tree)
            .into_iter()
            .find(|(n, _)| n == name)
            .map(|(_, v)| to_ros(v))
            .unwrap_or_default()
    }

    /// All values.
    pub fn all(&self) -> Vec<Parameter> {
        let names = self.names();
        names.into_iter().map(|name| Parameter { value: self.get(&name), name }).collect()
    }

    /// What is known about a name; only the name when there is no such parameter.
    pub fn describe(&self, name: &str) -> ParameterDescriptor {
        let mut out = ParameterDescriptor { name: name.into(), ..Default::default() };
        if !self.names().iter().any(|n| n == name) {
            return out;
        }
        out.r#type = self.get(name).r#type;
        out.read_only = !self.is_live(name);
        out.description = match self.fixed.get(name) {
            Some((_, text)) => (*text).into(),
            None => (self.describe)(name).into(),
        };
        let unset = self.types.pointer(&format!("/{}", name.replace('.', "/")));
        out.dynamic_typing = unset.is_some_and(Value::is_null);
        out
    }

    /// Sets all or nothing.
    ///
    /// # Errors
    /// A sentence for the operator.
    pub fn set(&self, parameters: &[Parameter]) -> Result<(), String> {
        let mut tree = self.tree();
        let mut next = tree.clone();
        let names: Vec<String> = flatten(&tree).into_iter().map(|(name, _)| name).collect();
        let mut problems = Vec::new();
        for Parameter { name, value } in parameters {
            let known = names.contains(name);
            if self.fixed.contains_key(name) || (known && !self.is_live(name)) {
                return Err(format!(
                    "parameter '{name}' is read-only while the node runs: set it at the start \
                     (-p {name}:=VALUE or the parameter file)"
                ));
            }
            let value =
                from_ros(value).ok_or_else(|| format!("parameter '{name}': unknown value type"))?;
            // Types are those of the defaults, not of whatever an unset field holds now.
            let mut check = self.types.clone();
            merge(&mut check, nested(name, value.clone()), "the request", &mut problems);
            merge(&mut next, nested(name, value), "the request", &mut Vec::new());
            if known && next.pointer(&format!("/{}", name.replace('.', "/"))).is_none() {
                problems.push(format!("parameter '{name}' cannot be set"));
            }
        }
        if !problems.is_empty() {
            return Err(problems.join("; "));
        }
        (self.apply)(next.clone())?;
        *tree = next;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::{Deserialize, Serialize};
    use serde_json::json;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct Demo {
        speed: f64,
        port: u16,
        gains: Gains,
        label: Option<String>,
    }
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct Gains {
        p: f64,
    }
    impl Default for Demo {
        fn default() -> Self {
            Self { speed: 0.2, port: 30004, gains: Gains { p: 1.0 }, label: None }
        }
    }
    impl Parameters for Demo {
        fn validate(&self) -> Vec<String> {
            if self.speed <= 0.25 { vec![] } else { vec!["'speed' must be at most 0.25".into()] }
        }
        fn live() -> &'static [&'static str] {
            &["speed", "gains", "label"]
        }
        fn describe(name: &str) -> &'static str {
            if name == "speed" { "m/s" } else { "" }
        }
    }

    fn parameter(name: &str, value: serde_json::Value) -> Parameter {
        Parameter { name: name.into(), value: to_ros(&value) }
    }

    #[test]
    fn live_sets() {
        let (store, params) = Store::new(Demo::default(), true);
        assert_eq!(store.names(), ["gains.p", "label", "port", "speed", "use_sim_time"]);
        assert!(store.get("use_sim_time").bool_value);
        store.set(&[parameter("speed", json!(0.1)), parameter("gains.p", json!(2))]).expect("set");
        assert_eq!((params.get().speed, params.get().gains.p), (0.1, 2.0));
        store.set(&[parameter("label", json!("x"))]).expect("set");
        store.set(&[parameter("label", json!("y"))]).expect("set again");
        assert_eq!(params.get().label.as_deref(), Some("y"));
        assert_eq!(store.get("speed").double_value, 0.1);
    }

    #[test]
    fn refusals_change_nothing() {
        let (store, params) = Store::new(Demo::default(), false);
        for (name, value, part) in [
            ("speed", json!(0.3), "at most 0.25"),
            ("speed", json!("fast"), "wants a number"),
            ("port", json!(1), "read-only"),
            ("use_sim_time", json!(true), "read-only"),
            ("sped", json!(0.1), "did you mean 'speed'"),
        ] {
            let both = [parameter("gains.p", json!(5.0)), parameter(name, value)];
            let text = store.set(&both).expect_err(name);
            assert!(text.contains(part), "{text}");
            assert_eq!(*params.get(), Demo::default());
            assert_eq!(store.get("gains.p").double_value, 1.0);
        }
    }

    #[test]
    fn descriptions() {
        let (store, _params) = Store::new(Demo::default(), false);
        let speed = store.describe("speed");
        assert_eq!((speed.description.as_str(), speed.read_only, speed.r#type), ("m/s", false, 3));
        assert!(store.describe("port").read_only);
        assert!(store.describe("label").dynamic_typing);
        assert_eq!(store.describe("nothing").r#type, 0);
    }
}
