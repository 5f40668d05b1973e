//! A refinement in parts, from object storage, and with temporarily unreadable files.

use crate::common::refined::{Columns, command, refine, temporary};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// A dozen simulated frames in a folder named `flight`.
fn flight() -> (TempDir, PathBuf) {
    let folder = temporary();
    let flight = folder.path().join("flight");
    let mut simulate = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    let simulate = simulate.args(["simulate", "--frames", "12", "--out"]);
    assert!(simulate.arg(&flight).output().unwrap().status.success());
    (folder, flight)
}

fn tables(out: &Path) -> Vec<Vec<u8>> {
    ["aspect.fits", "aspect.csv", "summary.json", "report.html"]
        .map(|name| fs::read(out.join(name)).unwrap())
        .into()
}

fn frames(archive: &Path) -> Vec<PathBuf> {
    solaspect::archive::check::Tree::of(archive).unwrap().files
}

#[test]
fn a_shard_that_was_lost_is_named_and_its_frames_are_solved_by_the_merge() {
    let (folder, archive) = flight();
    let [whole, merged] = ["whole", "merged"].map(|name| folder.path().join(name));
    refine(&archive, &whole, &[]);
    // A shard runs without the files that only the second pass needs.
    let more = ["--shard", "1/3", "--imu", "none.csv", "--gps", "none.csv"];
    let printed = refine(&archive, &merged.join("shard_1"), &more);
    let printed = String::from_utf8(printed.stdout).unwrap();
    assert!(printed.starts_with("shard 1/3: "), "{printed}");
    assert!(
        printed.ends_with(": 4 files, 0 of them unreadable\n"),
        "{printed}"
    );
    let [done, lost] = ["shard_1", "shard_2"].map(|name| merged.join(name));
    fs::create_dir(&lost).unwrap();
    let [done, lost] = [&done, &lost].map(|path| path.to_str().unwrap());
    let output = refine(&archive, &merged, &["--merge", done, lost]);
    let warning = String::from_utf8(output.stderr).unwrap();
    assert!(
        warning.contains(&format!("{lost}: expected a journal")),
        "{warning}"
    );
    assert!(!warning.contains(&format!("{done}: expected")), "{warning}");
    assert!(tables(&whole) == tables(&merged));
}

#[test]
fn merging_opens_no_frame_that_a_shard_has_solved() {
    let (folder, archive) = flight();
    let out = |name: &str| folder.path().join(name);
    refine(&archive, &out("whole"), &[]);
    refine(&archive, &out("shard"), &["--shard", "1/1"]);
    // Frames not fine by themselves are solved again by the merge; the content of the others is replaced, size and time are kept.
    let table = Columns::read(&out("whole"), "ASPECT");
    let names = table.texts("FILE").iter().zip(table.texts("OWN_QUALITY"));
    let fine: Vec<&String> = names
        .filter(|(_, own)| *own == "fine")
        .map(|(name, _)| name)
        .collect();
    assert!(fine.len() > 6);
    for path in fine.into_iter().map(|name| archive.join(name)) {
        let metadata = path.metadata().unwrap();
        fs::write(&path, vec![b'x'; metadata.len() as usize]).unwrap();
        let file = fs::File::options().write(true).open(&path).unwrap();
        file.set_modified(metadata.modified().unwrap()).unwrap();
    }
    let shard = out("shard");
    refine(
        &archive,
        &out("merged"),
        &["--merge", shard.to_str().unwrap()],
    );
    assert!(tables(&out("whole")) == tables(&out("merged")));
}

#[test]
fn a_file_that_cannot_be_read_for_now_is_a_row_and_is_tried_again() {
    let (folder, archive) = flight();
    let file = frames(&archive)[3].clone();
    let away = folder.path().join("away.fits");
    fs::rename(&file, &away).unwrap();
    symlink(&away, &file).unwrap();
    let [whole, out] = ["whole", "out"].map(|name| folder.path().join(name));
    refine(&archive, &whole, &[]);
    let hidden = folder.path().join("hidden");
    fs::rename(&away, &hidden).unwrap();
    let output = command(&archive, &out, &[]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let printed = String::from_utf8(output.stderr).unwrap();
    assert!(
        printed.contains("found 1 that could not be read"),
        "{printed}"
    );
    assert!(printed.contains("run again"), "{printed}");
    let table = Columns::read(&out, "ASPECT");
    assert_eq!(table.texts("FILE").len(), 12);
    let reasons = table.texts("REASON").iter();
    assert_eq!(
        reasons
            .filter(|reason| reason.contains("read the file"))
            .count(),
        1
    );
    fs::rename(&hidden, &away).unwrap();
    refine(&archive, &out, &[]);
    assert!(tables(&whole) == tables(&out));
}

#[cfg(feature = "object-store")]
#[test]
fn an_archive_named_by_its_url_gives_the_same_bytes_as_its_folder() {
    let (folder, archive) = flight();
    fs::write(archive.join(".hidden.fits"), "no frame").unwrap();
    let url = PathBuf::from(format!("file://{}", archive.display()));
    let [whole, out] = ["whole", "out"].map(|name| folder.path().join(name));
    refine(&archive, &whole, &[]);
    refine(&url, &out, &[]);
    assert!(tables(&whole) == tables(&out));
}

#[test]
fn a_url_that_cannot_be_read_is_named_in_one_line() {
    let folder = temporary();
    let urls = ["file:///nowhere/at/all", "ftp://host/flight", "s3://"];
    for url in urls {
        let output = command(Path::new(url), &folder.path().join("out"), &[]);
        let output = { output }.output().unwrap();
        let printed = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{url}: {printed}");
        assert!(
            printed.starts_with(&format!("solaspect: {url}: expected ")),
            "{printed}"
        );
        assert_eq!(printed.lines().count(), 1, "{printed}");
    }
}
