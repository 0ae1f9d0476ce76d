//! A data directory with many records, for the benchmarks of the whole service, and their
//! yardstick.

use std::path::Path;
use std::time::Instant;

use quadmark::config::{Config, Settings};
use quadmark::keys::KeyRing;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};

/// The median time of some loads, in seconds.
#[allow(dead_code, reason = "not every benchmark times")]
pub fn tobj_seconds(bytes: &[u8], loads: usize) -> f64 {
    let options = tobj::LoadOptions { triangulate: true, ..tobj::LoadOptions::default() };
    let mut times: Vec<f64> = (0..loads)
        .map(|_| {
            let start = Instant::now();
            let mut reader = bytes;
            let none = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
            let (models, _) = tobj::load_obj_buf(&mut reader, &options, none).unwrap();
            std::hint::black_box(models.len());
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[loads / 2]
}

/// Fills a registry up to `records` records with random salts and messages, written by the database
/// itself. Schema and master key must exist.
pub async fn seed(data: &Path, records: u64) {
    let key_id = KeyRing::open(&data.join("master.keys")).unwrap().current().to_owned();
    let options = SqliteConnectOptions::new().filename(data.join("registry.sqlite"));
    let pool = SqlitePool::connect_with(options).await.unwrap();
    let (there,): (i64,) =
        sqlx::query_as("SELECT count(*) FROM watermarks").fetch_one(&pool).await.unwrap();
    let wanted = i64::try_from(records).unwrap() - there;
    if wanted > 0 {
        let start = Instant::now();
        sqlx::query(
            "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < ?1),
             t (i, at) AS (SELECT i, printf('%012x', 1790000000000 + (?3 + i) / 8) FROM n)
             INSERT INTO watermarks
                 (id, owner_id, method, scheme, strength, bits, key_id, salt, message, centre_x,
                  centre_y, centre_z, rho_min, rho_max, host_sha256, marked_sha256, marked_bytes,
                  format, vertices, triangles, usable_bins, file_kept, host_kept, created_at)
             SELECT substr(at, 1, 8) || '-' || substr(at, 9) || '-7' || printf('%03x', i % 4096)
                        || '-8' || substr(lower(hex(randomblob(2))), 2) || '-'
                        || lower(hex(randomblob(6))),
                    'owner-' || (i % 1000), 'qsp-mean', 1, 0.1, 64, ?2, randomblob(32),
                    randomblob(8), 0.5, 0.25, -0.125, 0.1, 1.9, randomblob(32), randomblob(32),
                    1000000, 'obj', 20000, 40000, 64, 0, 0, 1790000000000000 + i
             FROM t",
        )
        .bind(wanted)
        .bind(key_id)
        .bind(there)
        .execute(&pool)
        .await
        .unwrap();
        println!("seeded {wanted} records in {:.1} s", start.elapsed().as_secs_f64());
    }
    pool.close().await;
}

/// The default configuration.
pub fn config(data: &Path) -> Config {
    let settings = Settings { data: Some(data.to_owned()), ..Settings::default() };
    Config::decide(settings).unwrap()
}
