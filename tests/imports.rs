//! Imports are acyclic, between the files of the library and between its folders.
//!
//! A file may import from the module that contains it: only imports between siblings are counted.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree, Visibility};

/// Names of modules from the crate's root down.
type Module = Vec<String>;

/// Paths and re-exports of one file.
#[derive(Default)]
struct File {
    /// Paths that begin with `crate`, `super`, `self` or a name.
    paths: BTreeSet<Vec<String>>,
    /// Re-exported names and the paths that they come from.
    exports: BTreeMap<String, Vec<String>>,
}

impl<'ast> Visit<'ast> for File {
    fn visit_item(&mut self, item: &'ast Item) {
        match item {
            Item::Mod(module) if is_for_tests(&module.attrs) => {}
            Item::Use(import) => {
                let mut paths = Vec::new();
                spread(&import.tree, &mut Vec::new(), &mut paths);
                for (name, path) in paths {
                    match import.vis {
                        Visibility::Inherited => _ = self.paths.insert(path),
                        _ => _ = self.exports.insert(name, path),
                    }
                }
            }
            item => visit::visit_item(self, item),
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names = path.segments.iter().map(|part| part.ident.to_string());
        self.paths.insert(names.collect());
        visit::visit_path(self, path);
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    let mut lists = attributes.iter().filter_map(|a| a.meta.require_list().ok());
    lists.any(|list| list.path.is_ident("cfg") && list.tokens.to_string() == "test")
}

/// Collects the imported names of a tree, each with its path.
fn spread(tree: &UseTree, above: &mut Vec<String>, paths: &mut Vec<(String, Vec<String>)>) {
    let with = |last: String| [above.as_slice(), &[last]].concat();
    match tree {
        UseTree::Path(path) => {
            above.push(path.ident.to_string());
            spread(&path.tree, above, paths);
            above.pop();
        }
        UseTree::Group(group) => {
            for tree in &group.items {
                spread(tree, above, paths);
            }
        }
        UseTree::Name(name) => {
            let name = name.ident.to_string();
            paths.push((name.clone(), with(name)));
        }
        UseTree::Rename(rename) => {
            paths.push((rename.rename.to_string(), with(rename.ident.to_string())));
        }
        UseTree::Glob(_) => paths.push(("*".into(), above.clone())),
    }
}

/// The files under a folder, each with its module path.
fn sources(root: &Path) -> Vec<(Module, PathBuf)> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            if path.extension().is_none_or(|ending| ending != "rs") {
                continue;
            }
            let inside = path.strip_prefix(root).unwrap().with_extension("");
            let mut module: Module = inside
                .iter()
                .map(|name| name.to_str().unwrap().to_owned())
                .collect();
            module.retain(|name| !["mod", "lib"].contains(&name.as_str()));
            let apart = ["main", "tests"].contains(&module.last().map_or("", String::as_str));
            if !apart {
                found.push((module, path));
            }
        }
    }
    found
}

/// The file to which a path in `from` leads.
fn resolve(files: &BTreeMap<Module, File>, from: &Module, path: &[String]) -> Option<Module> {
    let mut at = from.clone();
    let mut rest = path.iter().peekable();
    match path.first()?.as_str() {
        "crate" => {
            at.clear();
            rest.next();
        }
        "self" => _ = rest.next(),
        "super" => {
            while rest.next_if(|name| *name == "super").is_some() {
                at.pop();
            }
        }
        name => {
            let child = [at.as_slice(), &[name.to_owned()]].concat();
            files.get(&child)?;
        }
    }
    for name in rest {
        let child = [at.as_slice(), &[name.to_owned()]].concat();
        if files.contains_key(&child) {
            at = child;
        } else if let Some(export) = files[&at].exports.get(name) {
            return resolve(files, &at, export).or(Some(at));
        } else {
            break;
        }
    }
    Some(at)
}

/// The nodes that are part of a cycle.
fn circular<N: Ord + Clone>(edges: &BTreeMap<N, BTreeSet<N>>) -> Vec<N> {
    let reaches_itself = |from: &&N| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![*from]);
        while let Some(node) = open.pop() {
            open.extend(
                edges
                    .get(node)
                    .into_iter()
                    .flatten()
                    .filter(|next| seen.insert(*next)),
            );
        }
        seen.contains(*from)
    };
    edges.keys().filter(reaches_itself).cloned().collect()
}

/// The two children, of the deepest folder that contains both modules, through which they are reached. `None` if one contains the other.
fn parting(from: &Module, to: &Module) -> Option<(Module, Module)> {
    let shared = from.iter().zip(to).take_while(|(a, b)| a == b).count();
    let child = |module: &Module| module.get(..=shared).map(<[String]>::to_vec);
    child(from).zip(child(to))
}

/// The imports of every file: its module, and the modules that it imports from.
fn imports() -> BTreeMap<Module, BTreeSet<Module>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let read = |(module, path): (Module, PathBuf)| {
        let text = fs::read_to_string(&path).unwrap();
        let syntax = syn::parse_file(&text).unwrap();
        let mut file = File::default();
        file.visit_file(&syntax);
        (module, file)
    };
    let files: BTreeMap<Module, File> = sources(&root).into_iter().map(read).collect();
    let imports_of = |(module, file): (&Module, &File)| {
        let paths = file.paths.iter().chain(file.exports.values());
        let ends = paths.filter_map(|path| resolve(&files, module, path));
        let aside = ends.filter(|end| !module.starts_with(end) && !end.starts_with(module));
        (module.clone(), aside.collect())
    };
    let imports: BTreeMap<_, BTreeSet<_>> = files.iter().map(imports_of).collect();
    let count: usize = imports.values().map(BTreeSet::len).sum();
    assert!(count > 300, "few imports were found");
    imports
}

fn words(modules: &[Module]) -> Vec<String> {
    modules.iter().map(|module| module.join("::")).collect()
}

#[test]
fn imports_run_in_no_circle_of_files() {
    let circular = circular(&imports());
    assert!(circular.is_empty(), "in a circle: {:#?}", words(&circular));
}

#[test]
fn imports_run_in_no_circle_of_folders() {
    let mut edges: BTreeMap<Module, BTreeSet<Module>> = BTreeMap::new();
    for (from, ends) in imports() {
        for (here, there) in ends.iter().filter_map(|end| parting(&from, end)) {
            edges.entry(here).or_default().insert(there);
        }
    }
    let circular = circular(&edges);
    assert!(circular.is_empty(), "in a circle: {:#?}", words(&circular));
}
