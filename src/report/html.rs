//! A self-contained page: text, tables, figures as SVG and pictures as PNG, all in one file.

use base64::prelude::{BASE64_STANDARD, Engine};
use image::{EncodableLayout, ImageBuffer, ImageFormat, PixelWithColorType};
use std::fmt::Write;
use std::io::Cursor;
use std::ops::Deref;

/// A page under construction.
#[derive(Debug, Clone, Default)]
pub struct Page {
    body: String,
}

/// A light theme on every screen; on A4 no element that fits a sheet is split.
const STYLE: &str = ":root{color-scheme:light}\
body{font-family:system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222;background:#fff}\
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #ccc;padding:.3em .7em;text-align:left;vertical-align:top}\
td:last-child{overflow-wrap:anywhere}svg,img{max-width:100%;height:auto}figure{display:inline-block;margin:.5em;vertical-align:top}\
figcaption{font-size:.85em;color:#555;overflow-wrap:anywhere}figure.picture figcaption{max-width:200px}\
figure.plot{display:block;margin:1em 0}.note{color:#555}\
pre{background:#f5f5f5;padding:1em;white-space:pre-wrap;overflow-wrap:anywhere}\
@page{size:A4;margin:15mm}\
@media print{body{max-width:none;margin:0;padding:0;font-size:9.5pt}h2,thead{break-after:avoid}figure,tr{break-inside:avoid}\
figure.plot svg{max-height:105mm}td,th{padding:.15em .4em}pre{font-size:8pt}.note,figcaption{color:#222}}";

/// A text escaped for HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

impl Page {
    pub fn heading(&mut self, text: &str) {
        self.body += &format!("<h2>{}</h2>\n", escaped(text));
    }

    pub fn note(&mut self, text: &str) {
        self.body += &format!("<p class=\"note\">{}</p>\n", escaped(text));
    }

    /// Preformatted lines of text.
    pub fn preformatted(&mut self, text: &str) {
        self.body += &format!("<pre>{}</pre>\n", escaped(text));
    }

    /// A table: the column headings (empty for a table of names and values), and its rows.
    pub fn table(&mut self, heads: &[&str], rows: &[Vec<String>]) {
        self.body += "<table>\n";
        let line = |cells: Vec<String>, tag: &str| {
            let cells = cells.iter();
            let cells: String = cells
                .map(|c| format!("<{tag}>{}</{tag}>", escaped(c)))
                .collect();
            format!("<tr>{cells}</tr>\n")
        };
        if !heads.is_empty() {
            let heads = heads.iter().map(|head| (*head).to_owned()).collect();
            self.body += &format!("<thead>{}</thead>\n", line(heads, "th"));
        }
        for row in rows {
            self.body += &line(row.clone(), "td");
        }
        self.body += "</table>\n";
    }

    /// A figure drawn by [`plot`](super::plot), with a caption.
    pub fn figure(&mut self, svg: &str, caption: &str) {
        let caption = match caption {
            "" => String::new(),
            caption => format!("<figcaption>{}</figcaption>", escaped(caption)),
        };
        let _ = writeln!(self.body, "<figure class=\"plot\">{svg}{caption}</figure>");
    }

    /// A small picture with a caption; a picture that cannot be encoded is skipped.
    pub fn picture<P, C>(&mut self, picture: &ImageBuffer<P, C>, caption: &str)
    where
        P: PixelWithColorType<Subpixel = u8>,
        [P::Subpixel]: EncodableLayout,
        C: Deref<Target = [u8]>,
    {
        let mut png = Cursor::new(Vec::new());
        if picture.write_to(&mut png, ImageFormat::Png).is_ok() {
            let caption = escaped(caption);
            let data = BASE64_STANDARD.encode(png.into_inner());
            let image = format!("<img alt=\"{caption}\" src=\"data:image/png;base64,{data}\">");
            self.body += &format!(
                "<figure class=\"picture\">{image}<figcaption>{caption}</figcaption></figure>\n"
            );
        }
    }

    /// Appends another page.
    pub fn append(&mut self, other: Self) {
        self.body += &other.body;
    }

    /// The complete page with a title.
    pub fn finish(self, title: &str) -> String {
        let title = escaped(title);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style></head>\n\
             <body><h1>{title}</h1>\n{}</body></html>\n",
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::GrayImage;

    #[test]
    fn texts_cannot_break_the_page_and_pictures_stand_in_it() {
        let mut page = Page::default();
        page.heading("a <b> & \"c\"");
        page.table(&["x"], &[vec!["1 < 2".into()]]);
        page.picture(&GrayImage::new(4, 3), "four by three");
        let text = page.finish("t");
        assert!(text.contains("<h2>a &lt;b&gt; &amp; &quot;c&quot;</h2>"));
        assert!(text.contains("<td>1 &lt; 2</td>"));
        assert!(text.contains("data:image/png;base64,iVBOR"));
    }
}
