//! Built-in functions that need no robot: "Module urmath" and parts of "Module internals" and
//! "Module interfaces" of the script manual.

mod lists;
mod math;
mod pose;
mod text;

use crate::error::ErrorKind;
use crate::host::Functions;
use crate::value::Value;
use std::sync::OnceLock;

type Result<T> = std::result::Result<T, ErrorKind>;

/// The built-in functions in the notation of [`Functions::parse`].
pub const BUILTINS: &str = "\
sync()
sleep(t)
acos(f)
asin(f)
atan(f)
atan2(x, y)
ceil(f)
cos(f)
d2r(d)
floor(f)
log(b, f)
norm(a)
normalize(v)
pow(base, exponent)
r2d(r)
random()
sin(f)
sqrt(f)
tan(f)
pose_trans(p_from, p_from_to)
pose_inv(p_from)
pose_add(p_1, p_2)
pose_sub(p_to, p_from)
pose_dist(p_from, p_to)
point_dist(p_from, p_to)
interpolate_pose(p_from, p_to, alpha)
rotvec2rpy(rotation_vector)
rpy2rotvec(rpy_vector)
wrench_trans(T_from_to, w_from)
get_list_length(v)
length(v)
size(v)
make_list(length, initial_value, capacity = None)
binary_list_to_integer(l)
integer_to_binary_list(x)
transpose(m)
inv(m)
str_at(src, index)
str_cat(op1, op2)
str_empty(str)
str_find(src, target, start_from = 0)
str_len(str)
str_sub(src, index, len = None)
to_str(val)
to_num(str)
";

/// The parsed table.
pub(crate) fn signatures() -> &'static Functions {
    static TABLE: OnceLock<Functions> = OnceLock::new();
    // The table is a constant that a test parses; an empty one would make every name unknown.
    TABLE.get_or_init(|| Functions::parse(BUILTINS).unwrap_or_default())
}

/// Calls a built-in by its number in the table. No result is larger than `limit`.
pub(crate) fn call(number: usize, args: &[Value], random: &mut u64, limit: usize) -> Result<Value> {
    let name = &*signatures().list()[number].name;
    let arg = |at: usize| args.get(at).unwrap_or(&Value::Nothing);
    match name {
        "random" => Ok(Value::Float(math::random(random))),
        "norm" => math::norm(arg(0)),
        "normalize" => math::normalize(arg(0)),
        "atan2" | "pow" | "log" => math::two(name, number_of(arg(0))?, number_of(arg(1))?),
        "acos" | "asin" | "atan" | "ceil" | "cos" | "d2r" | "floor" | "r2d" | "sin" | "sqrt"
        | "tan" => math::one(name, number_of(arg(0))?),
        "interpolate_pose" => {
            let alpha = number_of(arg(2))?;
            Ok(Value::Pose(pose::interpolate(&six(arg(0))?, &six(arg(1))?, alpha)))
        }
        "pose_inv" => Ok(Value::Pose(pose::inverse(&six(arg(0))?))),
        "pose_trans" | "pose_add" | "pose_sub" | "pose_dist" | "point_dist" | "wrench_trans" => {
            pose::two(name, &six(arg(0))?, &six(arg(1))?)
        }
        "rotvec2rpy" | "rpy2rotvec" => pose::rotation(name, arg(0)),
        "get_list_length"
        | "length"
        | "size"
        | "make_list"
        | "binary_list_to_integer"
        | "integer_to_binary_list"
        | "transpose"
        | "inv" => lists::call(name, args, limit),
        _ => text::call(name, args, limit),
    }
}

fn number_of(value: &Value) -> Result<f64> {
    value
        .number()
        .ok_or_else(|| ErrorKind::of_type(format!("a number is needed, not {}", value.kind())))
}

fn integer_of(value: &Value) -> Result<i32> {
    value.integer().ok_or_else(|| {
        ErrorKind::of_type(format!("a whole number is needed, not {}", value.kind()))
    })
}

fn six(value: &Value) -> Result<[f64; 6]> {
    value.six().ok_or_else(|| ErrorKind::of_type(format!("a pose is needed, not {}", value.kind())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_parses_and_every_entry_is_carried_out() {
        let table = Functions::parse(BUILTINS).unwrap();
        assert_eq!(table.list().len(), BUILTINS.lines().count());
        for (number, signature) in table.list().iter().enumerate().skip(2) {
            let args = vec![Value::Nothing; signature.parameters.len()];
            if let Err(error) = call(number, &args, &mut 1, 100) {
                assert!(!matches!(error, ErrorKind::NotDefined(_)), "{}: {error}", signature.name);
            }
        }
    }
}
