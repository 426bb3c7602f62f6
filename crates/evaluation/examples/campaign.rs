fn main() {
    let mut args = std::env::args().skip(1).map(|a| a.parse::<u64>().unwrap());
    let (first, n) = (args.next().unwrap_or(1), args.next().unwrap_or(4));
    let scene = tdv_simulation::Scene::load(std::path::Path::new("config/scenes/cup_on_coaster.yaml")).unwrap();
    let assets = std::sync::Arc::new(tdv_simulation::LabAssets::load(scene).unwrap());
    let t = std::time::Instant::now();
    let r = tdv_evaluation::campaign::run_campaign(&assets, first, n, &|_| {}).unwrap();
    println!("{}", r.table());
    println!("{:.1} s", t.elapsed().as_secs_f64());
}
