//! What the pages of all calibrations share.

use super::frames::LeftOut;
use crate::report::html::escaped;
use std::fmt::Write;

const STYLE: &str = "body{font:15px/1.45 sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
table{border-collapse:collapse;width:100%}td,th{border-bottom:1px solid #ccc;padding:.35em .6em;text-align:left;vertical-align:top}\
.determined{color:#137333}.kept{color:#a33}svg{max-width:100%;height:auto}code{background:#f3f3f3}";

/// The start of a page.
pub(super) fn head(title: &str, source: &str) -> String {
    let (title, source) = (escaped(title), escaped(source));
    format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style>\n\
         <h1>{title}</h1>\n<p>{source}</p>\n"
    )
}

/// The frames that did not take part.
pub(super) fn left_out(left_out: &[LeftOut]) -> String {
    let mut html = format!("<h2>Left out: {}</h2>\n<table>\n", left_out.len());
    for LeftOut { name, reason } in left_out {
        let (name, reason) = (escaped(name), escaped(reason));
        let _ = writeln!(
            html,
            "<tr><td><code>{name}</code></td><td>{reason}</td></tr>"
        );
    }
    html + "</table>\n"
}
