use crate::plot::escape;
use base64::Engine as _;
use std::fmt::Write as _;

/// A self-contained HTML page: no script, no outside file.
#[derive(Debug, Clone)]
pub struct Page {
    title: String,
    body: String,
}

const STYLE: &str = "\
:root{color-scheme:light dark;--fg:#1c2530;--bg:#fff;--soft:#5c6b7a;--line:#d7dee6;--card:#f6f8fa}\
@media(prefers-color-scheme:dark){:root{--fg:#e2e8ef;--bg:#12181f;--soft:#93a1b0;--line:#2c3742;--card:#1a222b}}\
body{font:15px/1.5 system-ui,sans-serif;color:var(--fg);background:var(--bg);max-width:1100px;margin:2rem auto;padding:0 1rem}\
h1{font-size:1.6rem;margin-bottom:.2rem}h2{margin-top:2rem;border-bottom:1px solid var(--line);padding-bottom:.2rem}\
p.lead{color:var(--soft);margin-top:0}table{border-collapse:collapse;margin:.5rem 0}\
td,th{padding:.25rem .7rem;border-bottom:1px solid var(--line);text-align:left}th{color:var(--soft);font-weight:600}\
.row{display:flex;flex-wrap:wrap;gap:1rem;align-items:flex-start}.row>figure{flex:1 1 300px;margin:0;background:var(--card);border-radius:8px;padding:.5rem}\
figure img,figure svg{width:100%;height:auto;border-radius:4px}figcaption{color:var(--soft);font-size:.85rem}\
svg text{fill:currentColor;font:11px system-ui,sans-serif}svg .title{font-weight:600;font-size:12px}\
svg .grid{stroke:var(--line)}svg .tick{fill:var(--soft)}svg .thin{fill:none;stroke:#7a8ea3;stroke-width:.7;opacity:.55}";

impl Page {
    /// An empty page with a heading and one sentence below it.
    pub fn new(title: &str, lead: &str) -> Self {
        let body = format!("<h1>{}</h1><p class=\"lead\">{}</p>", escape(title), escape(lead));
        Self { title: title.to_owned(), body }
    }

    /// A section heading.
    pub fn section(&mut self, title: &str) -> &mut Self {
        let _ = write!(self.body, "<h2>{}</h2>", escape(title));
        self
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) -> &mut Self {
        let _ = write!(self.body, "<p>{}</p>", escape(text));
        self
    }

    /// A table with a head row.
    pub fn table(&mut self, head: &[&str], rows: &[Vec<String>]) -> &mut Self {
        self.body.push_str("<table><tr>");
        for h in head {
            let _ = write!(self.body, "<th>{}</th>", escape(h));
        }
        self.body.push_str("</tr>");
        for row in rows {
            self.body.push_str("<tr>");
            for cell in row {
                let _ = write!(self.body, "<td>{}</td>", escape(cell));
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</table>");
        self
    }

    /// SVG drawings side by side, each with a caption.
    pub fn drawings(&mut self, drawings: &[(String, &str)]) -> &mut Self {
        self.body.push_str("<div class=\"row\">");
        for (svg, caption) in drawings {
            let _ = write!(
                self.body,
                "<figure>{svg}<figcaption>{}</figcaption></figure>",
                escape(caption)
            );
        }
        self.body.push_str("</div>");
        self
    }

    /// Encoded pictures side by side: MIME type, bytes, caption.
    pub fn pictures(&mut self, pictures: &[(&str, Vec<u8>, String)]) -> &mut Self {
        self.body.push_str("<div class=\"row\">");
        for (mime, bytes, caption) in pictures {
            let data = base64::engine::general_purpose::STANDARD.encode(bytes);
            let _ = write!(
                self.body,
                "<figure><img alt=\"{0}\" src=\"data:{mime};base64,{data}\"><figcaption>{0}</figcaption></figure>",
                escape(caption)
            );
        }
        self.body.push_str("</div>");
        self
    }

    /// The page.
    pub fn html(&self) -> String {
        format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width\"><title>{}</title>\
             <style>{STYLE}</style></head><body>{}</body></html>\n",
            escape(&self.title),
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped_and_pictures_are_inline() {
        let mut page = Page::new("a < b", "lead");
        page.section("s & t").table(&["x"], &[vec!["<script>".into()]]).pictures(&[(
            "image/png",
            vec![1, 2, 3],
            "p".into(),
        )]);
        let html = page.html();
        assert!(!html.contains("<script>") && html.contains("data:image/png;base64,AQID"));
        assert!(html.contains("s &amp; t"));
    }
}
