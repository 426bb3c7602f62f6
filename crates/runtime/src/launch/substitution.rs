//! `$(var x)`, `$(env X)`, `$(env X default)`, `$(dirname)`, `$(find-pkg-share tdv)`.

use std::collections::BTreeMap;
use std::path::Path;

/// What substitutions can refer to.
pub struct Scope<'a> {
    pub variables: &'a BTreeMap<String, String>,
    /// Folder of the launch file.
    pub folder: &'a Path,
    /// What `find-pkg-share` gives: the folder that holds `config/` and `launch_scripts/`.
    pub share: &'a Path,
}

impl Scope<'_> {
    /// The text with every substitution done; an error is a sentence without the place.
    pub fn apply(&self, text: &str) -> Result<String, String> {
        let mut out = String::new();
        let mut rest = text;
        while let Some(begin) = rest.find("$(") {
            out.push_str(&rest[..begin]);
            let inner = &rest[begin + 2..];
            let end = inner.find(')').ok_or_else(|| format!("{text:?} has a $( without )"))?;
            out.push_str(&self.evaluate(&inner[..end])?);
            rest = &inner[end + 1..];
        }
        out.push_str(rest);
        Ok(out)
    }

    fn evaluate(&self, expression: &str) -> Result<String, String> {
        let words: Vec<&str> = expression.split_whitespace().collect();
        match words.as_slice() {
            ["var", name] => self.variables.get(*name).cloned().ok_or_else(|| {
                let known: Vec<&str> = self.variables.keys().map(String::as_str).collect();
                format!("$(var {name}) is not declared; arguments are: {}", known.join(", "))
            }),
            ["env", name] => {
                std::env::var(name).map_err(|_| format!("environment variable {name} is not set"))
            }
            ["env", name, default @ ..] => {
                Ok(std::env::var(name)
                    .unwrap_or_else(|_| default.join(" ").trim_matches('\'').into()))
            }
            ["dirname"] => Ok(self.folder.display().to_string()),
            ["find-pkg-share", "tdv"] => Ok(self.share.display().to_string()),
            _ => Err(format!(
                "$({expression}) is not supported here; var, env, dirname and find-pkg-share tdv are"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn substitutions() {
        let variables = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
        let scope =
            Scope { variables: &variables, folder: Path::new("/l"), share: Path::new("/s") };
        assert_eq!(scope.apply("a$(var seed)b$(dirname)").unwrap(), "a7b/l");
        assert_eq!(scope.apply("$(find-pkg-share tdv)/config").unwrap(), "/s/config");
        assert_eq!(scope.apply("$(env TDV_SURELY_NOT_SET 'x')").unwrap(), "x");
        for bad in ["$(var nope)", "$(var", "$(eval 1+1)", "$(env TDV_SURELY_NOT_SET)"] {
            assert!(scope.apply(bad).is_err(), "{bad}");
        }
    }
}
