use std::path::Path;
use tdv_bag::BagReader;

/// Prints what a bag holds.
pub fn info(path: &Path) -> anyhow::Result<()> {
    let reader = BagReader::open(path)?;
    println!("file:      {}", reader.path().display());
    match reader.span() {
        Some((first, last)) => {
            println!("start:     {:.3} s", first.as_secs());
            println!("duration:  {:.3} s", last.since(first));
        }
        None => println!("duration:  empty"),
    }
    println!("messages:  {}", reader.topics().iter().map(|t| t.count).sum::<u64>());
    for t in reader.topics() {
        let latched = if t.latched { " (latched)" } else { "" };
        println!("{:7}  {}  {}{latched}", t.count, t.name, t.type_name);
    }
    Ok(())
}
