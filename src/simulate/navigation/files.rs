//! A flight as files: tables with all digits of their numbers.

use super::{Flight, GpsRow, ImuRow, SunRow, TruthRow, VectorRow};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot write", .path.display())]
pub struct WriteError {
    pub path: PathBuf,
    #[source]
    pub cause: io::Error,
}

impl Flight {
    /// Writes `imu.csv`, `gps.csv`, `vectors.csv`, `sun.csv`, `truth.csv` and `NAV.toml` to an existing folder.
    pub fn write(&self, folder: &Path) -> Result<(), WriteError> {
        table(folder, "imu.csv", &self.imu)?;
        table(folder, "gps.csv", &self.gps)?;
        table(folder, "vectors.csv", &self.vectors)?;
        table(folder, "sun.csv", &self.sun)?;
        table(folder, "truth.csv", &self.truth)?;
        let path = folder.join("NAV.toml");
        std::fs::write(&path, &self.config_toml).map_err(|cause| WriteError { path, cause })
    }
}

/// A line of a table.
trait CsvRow {
    const HEADER: &str;

    fn write(&self, file: &mut impl Write) -> io::Result<()>;
}

fn table<T: CsvRow>(folder: &Path, name: &str, rows: &[T]) -> Result<(), WriteError> {
    let path = folder.join(name);
    write_rows(&path, rows).map_err(|cause| WriteError { path, cause })
}

fn write_rows<T: CsvRow>(path: &Path, rows: &[T]) -> io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    writeln!(file, "{}", T::HEADER)?;
    for row in rows {
        row.write(&mut file)?;
    }
    file.flush()
}

/// A line with a time and further numbers.
fn numbers<'a>(
    file: &mut impl Write,
    t_s: f64,
    values: impl IntoIterator<Item = &'a f64>,
) -> io::Result<()> {
    write!(file, "{t_s}")?;
    for value in values {
        write!(file, ",{value}")?;
    }
    writeln!(file)
}

impl CsvRow for ImuRow {
    const HEADER: &str = "t_s,fx_m_s2,fy_m_s2,fz_m_s2,wx_rad_s,wy_rad_s,wz_rad_s";

    fn write(&self, file: &mut impl Write) -> io::Result<()> {
        let values = self.specific_force_m_s2.iter().chain(&self.rate_rad_s);
        numbers(file, self.t_s, values)
    }
}

impl CsvRow for GpsRow {
    const HEADER: &str = "t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s";

    fn write(&self, file: &mut impl Write) -> io::Result<()> {
        let values = self.position_m.iter().chain(&self.velocity_m_s);
        numbers(file, self.t_s, values)
    }
}

impl CsvRow for VectorRow {
    const HEADER: &str = "t_s,camera,target,x,y,z,sigma_rad";

    fn write(&self, file: &mut impl Write) -> io::Result<()> {
        let Self { camera, target, .. } = self;
        let [x, y, z] = self.direction.into();
        writeln!(
            file,
            "{},{camera},{target},{x},{y},{z},{}",
            self.t_s, self.sigma_rad
        )
    }
}

impl CsvRow for TruthRow {
    const HEADER: &str = "t_s,q0,q1,q2,q3,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s";

    fn write(&self, file: &mut impl Write) -> io::Result<()> {
        let q = &self.ecef_from_body;
        let attitude = [q.w, q.i, q.j, q.k];
        let motion = self.position_m.iter().chain(&self.velocity_m_s);
        numbers(file, self.t_s, attitude.iter().chain(motion))
    }
}

impl CsvRow for SunRow {
    const HEADER: &str = "t_s,x,y,z";

    fn write(&self, file: &mut impl Write) -> io::Result<()> {
        numbers(file, self.t_s, &self.direction)
    }
}
